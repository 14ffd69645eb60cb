"""Figure of merit and time to a given error of every solver of the ladder, on a slab, a half-space and a spectrum.

Run `python benchmarks/bench_ladder.py [--error E] [--variant llvm|cuda]`.
The figure of merit is 1/(σ² t), σ the root mean square over the wavelengths of what a solver states of its error, t in
seconds without compiling. Deterministic solvers have none: beside their time stands their distance from
adding–doubling.
"""

from __future__ import annotations

import argparse
import math
from typing import get_args

import numpy as np

from livlab.acquire.instruments.integrating_sphere import IntegratingSphere
from livlab.acquire.instruments.models import Instrument
from livlab.acquire.instruments.spectrometer import Accuracy, SamplingRule, Variant, estimate
from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack

SOLVERS = ("kubelka-munk", "diffusion", "adding-doubling", "ledger", "walk analog", "walk expected", "auto")


def spectrum(count: int = 221) -> OpticalStack:
    """A capsule on a bulk whose absorption falls by a factor of 40 over the band."""
    x, one, phase = np.linspace(0, 1, count), np.ones(count), (HenyeyGreenstein(0.9),) * count
    layers = []
    for name, thick, n, absorption in (("capsule", 0.1, 1.36, 0.01 * one), ("bulk", math.inf, 1.38, 2.0 * 40**-x)):
        parts = (Interaction("a", absorption, 0 * one, phase), Interaction("s", 12.0 * one, one, phase))
        layers.append(PlaneLayer(name, thick, n * one, parts))
    return OpticalStack(500 + 220 * x, tuple(layers), one, one)


CASES: tuple[tuple[str, OpticalStack], ...] = (
    ("slab, 1 wavelength", plain_stack([(1.0, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))])),
    ("half-space, 1 wavelength", plain_stack([(1.4, 0.01, 5.0, math.inf, Isotropic())])),
    ("two layers, 221 wavelengths", spectrum()),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--error", type=float, default=2e-3)
    parser.add_argument("--variant", choices=get_args(Variant), default="llvm")
    options = parser.parse_args()
    sphere: Instrument = IntegratingSphere(port_diameter_mm="infinite", incidence_deg=0.0)
    wish = Accuracy(standard_error=options.error)
    for name, stack in CASES:
        print(f"{name}, to {options.error:g}")
        exact = estimate(stack, sphere, Accuracy(standard_error=1e-6), "adding-doubling").value
        for solver in SOLVERS:
            try:
                if solver in ("ledger", "walk analog", "walk expected"):  # compile
                    estimate(
                        stack, sphere, Accuracy(standard_error=1.0), solver, outside="warn", variant=options.variant
                    )
                found = estimate(
                    stack, sphere, wish, solver, outside="warn", sampling=SamplingRule(relative=0.1, seed=3),
                    variant=options.variant,
                )  # fmt: skip
            except InputError as error:
                print(f"  {solver:16s} {error.message}")
                continue
            sigma = float(np.sqrt(np.mean(np.square(found.standard_error))))
            off = float(np.abs(found.value - exact).max())
            merit = f"{1 / (sigma**2 * found.seconds):9.3g}" if sigma > 0 else "        –"
            mark = "" if found.valid.all() else "  outside its domain"
            print(
                f"  {solver:16s} {found.seconds:8.3f} s {found.samples:12,d} samples  1/(σ²t) {merit}"
                f"  off by {off:.1e} at most{mark}" + (f"  → {found.solver}" if solver == "auto" else "")
            )


if __name__ == "__main__":
    main()
