"""A spectrum of 221 wavelengths: the ledger beside the plain walk, at the same standard error, in one run.

Run `python benchmarks/bench_ledger.py [--error E] [--cases NAME ...] [--variant llvm|cuda] [--share S]`.
The plain walk needs minutes; it walks a share of its photons and is scaled, as time goes with their number.
Clock and processor seconds are both given: on a shared machine their ratios say more than either. "evaluate" is
a ledger read back from disk, compressed, and asked for the whole spectrum.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Phase
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.device import Variant
from livlab.model.transport.ledger.record_ledger import load, record
from livlab.model.transport.walk.walk import walk

BAND = np.arange(500.0, 720.5)
ONE = np.ones_like(BAND)
ABSORPTION = 0.5 * 10.0 ** np.linspace(0.6, -0.6, BAND.size)
"""1/mm, falling sixteenfold from green to red, as blood's does."""


def _plain(*layers: tuple[float, float, Any, float, Phase]) -> OpticalStack:
    made = []
    for k, (thickness, n, mua, mus, phase) in enumerate(layers):
        parts = (
            Interaction("absorber", mua * ONE, 0 * ONE, (phase,) * BAND.size),
            Interaction("scatterer", mus * ONE, ONE, (phase,) * BAND.size),
        )
        made.append(PlaneLayer(f"layer {k}", thickness, n * ONE, parts))
    return OpticalStack(BAND, tuple(made), ONE, ONE)


def _liver(name: str, whole: bool) -> OpticalStack:
    tissue = load_preset("liver")
    return optical_stack(tissue if whole else tissue.with_layers(("parenchyma",)), READINGS[name], BAND)


HG = HenyeyGreenstein(0.9)
CASES: dict[str, Callable[[], OpticalStack]] = {
    "slab": lambda: _plain((0.2, 1.0, 2 * ABSORPTION, 9.0, HenyeyGreenstein(0.75))),
    "half-space": lambda: _plain((math.inf, 1.5, 2 * ABSORPTION, 9.0, Isotropic())),
    "two layers": lambda: _plain((0.1, 1.36, 0.01, 10.0, HG), (50.0, 1.38, ABSORPTION, 15.0, HG)),
    "thesis, parenchyma": lambda: _liver("thesis", False),
    "consistent, parenchyma": lambda: _liver("consistent", False),
    "measured, parenchyma": lambda: _liver("measured", False),
    "thesis": lambda: _liver("thesis", True),
    "measured": lambda: _liver("measured", True),
    "consistent": lambda: _liver("consistent", True),
}
MCML = {"slab": 4.4e6, "half-space": 0.40e6, "two layers": 0.089e6}
"""Photons a second of MCML on two processes, at the middle of these bands."""


@dataclass(frozen=True)
class Spent:
    """Seconds by the clock and of the processor."""

    clock: float
    processor: float

    def __str__(self) -> str:
        return f"{self.clock:7.2f} s clock {self.processor:7.2f} s processor"


def timed(work: Callable[[], Any]) -> tuple[Any, Spent]:
    clock, processor = time.perf_counter(), time.process_time()
    found = work()
    return found, Spent(time.perf_counter() - clock, time.process_time() - processor)


def measure(name: str, error: float, variant: Variant, share: float) -> None:
    stack = CASES[name]()
    record(stack, samples=4096, seed=1, variant=variant).spectrum(degenerate="mark")  # compile
    ledger, recorded = timed(lambda: record(stack, standard_error=error, seed=2, variant=variant))
    found, answered = timed(lambda: ledger.spectrum(degenerate="mark"))
    reached = float(found.reflectance_se.max())
    print(f"{name}: {len(stack.layers)} layers, {BAND.size} wavelengths, reflectance {_range(found.reflectance)}")
    print(f"  ledger    {recorded} to record {ledger.photons} photons at {len(ledger.anchors)} anchors")
    print(f"            {answered} to answer; standard error at most {reached:.2e}, bias of interpolation "
          f"{ledger.about['interpolation_bias']:.1e}, valid {bool(found.valid.all())}")  # fmt: skip

    small, pressed = timed(ledger.compressed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger.nc"
        small.save(path)
        size = path.stat().st_size
        back, read = timed(lambda: load(path))
    again = np.sort([timed(lambda: _evaluate(back))[1].clock for _ in range(9)])
    print(f"  compress  {pressed}: {len(ledger)} rows to {len(small)}, {size / 1e6:.2f} MB, "
          f"error {small.compression.error:.1e}")  # fmt: skip
    print(f"  evaluate  {1e3 * again[4]:.1f} ms (best {1e3 * again[0]:.1f}), after {read.clock:.2f} s of reading")

    walk(stack, samples=64, seed=1, variant=variant)
    pilot = walk(stack, samples=1000, seed=1, variant=variant)
    wanted = float((pilot.reflectance_se**2).max()) * 1000 / reached**2
    samples = max(200, math.ceil(share * wanted))
    plain, walked = timed(lambda: walk(stack, samples=samples, seed=3, variant=variant))
    scale = float((plain.reflectance_se**2).max()) / reached**2
    whole = Spent(walked.clock * scale, walked.processor * scale)
    total = Spent(recorded.clock + answered.clock, recorded.processor + answered.processor)
    print(f"  walk      {whole} for the same error ({samples} photons a wavelength walked, times {scale:.1f})")
    if name in MCML:
        needed = BAND.size * samples * scale / MCML[name]
        ratio = needed / total.clock
        print(f"  MCML      {needed:7.1f} s clock for as many photons at its speed: {ratio:.0f} times longer")
    off = (plain.reflectance - found.reflectance) / np.hypot(plain.reflectance_se, found.reflectance_se)
    print(f"  speed-up  {whole.clock / total.clock:.0f} by the clock, {whole.processor / total.processor:.0f} by the "
          f"processor; they differ by {float(np.sqrt((off**2).mean())):.2f} joint standard errors in the mean square",
          flush=True)  # fmt: skip


def _evaluate(ledger: Any) -> Any:
    served = ledger.served
    return ledger.evaluate(served.absorption, served.scattering, wavelength_nm=served.wavelength_nm)


def _range(values: Any) -> str:
    return f"{float(values.min()):.4f} to {float(values.max()):.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--error", type=float, default=1e-3, help="standard error of the reflectance (1e-3)")
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--variant", choices=get_args(Variant), default="llvm")
    parser.add_argument("--share", type=float, default=0.02, help="of its photons that the plain walk walks (0.02)")
    given = parser.parse_args()
    for name in given.cases:
        measure(name, given.error, given.variant, given.share)


if __name__ == "__main__":
    main()
