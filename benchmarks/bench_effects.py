"""What leaving effects out saves on liver at 500–600 nm: time for equal standard error, full scene against planned.

Processor seconds of all threads, so that a busy machine changes little; paired and in turn. Run by hand:

    python -m benchmarks effects
"""

from __future__ import annotations

import time

import numpy as np

from livlab.acquire.instruments.collinear import Collinear
from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.models import Instrument
from livlab.effects.plan import plan
from livlab.effects.timing import time_pair
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS

TOLERANCE = 0.002
WAVELENGTHS = np.arange(500.0, 601.0, 10.0)
INSTRUMENTS: dict[str, Instrument] = {
    "camera": HyperspectralCamera(),
    "sphere, endless port": IntegratingSphere(port_diameter_mm="infinite"),
    "collinear, pencil on 1 cm²": Collinear(beam="pencil"),
    "collinear, lit face of 1 cm²": Collinear(),
}


def main() -> None:
    print(f"tolerance {TOLERANCE:g} of the value, {len(WAVELENGTHS)} wavelengths, weighted walk")
    for variant, names in (("parenchyma_only", INSTRUMENTS), ("whole", {"camera": INSTRUMENTS["camera"]})):
        for base in ("consistent", "measured"):
            tissue = load_preset("liver", variant=variant)
            stack = optical_stack(tissue, READINGS[base], WAVELENGTHS)
            for name in names:
                started = time.process_time()
                made = plan(stack, INSTRUMENTS[name], TOLERANCE, tissue=tissue, reading=READINGS[base])
                planned = time.process_time() - started
                print(f"{variant}, {base}, {name}: planned in {planned:.1f} s", end="", flush=True)
                if not made.dropped:
                    print("; nothing dropped")
                    continue
                found = time_pair(made.scene, made.reduced, seconds=4.0, pairs=4)
                print(
                    f"; bound {made.bound:.2g}; predicted {1 / (1 - made.predicted_saving):.1f}x, measured "
                    f"{found.factor:.2f}x ± {found.standard_error * found.factor**2:.2f} "
                    f"({found.full_ns:.0f} to {found.reduced_ns:.0f} ns a photon): without {', '.join(made.dropped)}"
                )


if __name__ == "__main__":
    main()
