"""Photons a second and figure of merit of the walk on three slabs, beside what a peer's speed was.

Run `python benchmarks/bench_walk.py [--seconds S] [--variant llvm|cuda] [--estimator expected|analog]`.
The figure of merit is 1/(σ² t), t in seconds: what doubles when the same error takes half the time.
Processor seconds are given as well: on a shared machine they say more than the clock's.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from typing import get_args

from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import OpticalStack, plain_stack
from livlab.model.transport.device import Variant
from livlab.model.transport.walk.tables import Estimator
from livlab.model.transport.walk.walk import walk

HG9 = HenyeyGreenstein(0.9)


@dataclass(frozen=True)
class Case:
    """A slab, its reflectance without the specular part, and photons a second of MCML on two processes."""

    name: str
    stack: OpticalStack
    reflectance: float
    mcml: float


CASES = (
    Case("i", plain_stack([(1.0, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))]), 0.0973946, 4.4e6),
    Case("ii", plain_stack([(1.5, 1.0, 9.0, math.inf, Isotropic())]), 0.2199186, 0.40e6),
    Case("iii", plain_stack([(1.36, 0.01, 10.0, 0.1, HG9), (1.38, 0.5, 15.0, 50.0, HG9)]), 0.1217318, 0.089e6),
)


@dataclass(frozen=True)
class Speed:
    """What one case came to."""

    photons: int
    clock: float
    processor: float
    compile: float
    value: float
    error: float

    @property
    def merit(self) -> float:
        """1/(σ² t) by the clock."""
        return 1.0 / (self.error**2 * self.clock)


def measure(case: Case, seconds: float, variant: Variant, estimator: Estimator) -> Speed:
    """Walk for about so many seconds, the compilation and a first small launch apart."""
    first = walk(case.stack, samples=200_000, seed=1, variant=variant, estimator=estimator)
    trial = walk(case.stack, samples=400_000, seed=2, variant=variant, estimator=estimator)
    photons = max(400_000, int(400_000 * seconds / trial.attrs["seconds"]))
    clock, processor = time.perf_counter(), time.process_time()
    result = walk(case.stack, samples=photons, seed=3, variant=variant, estimator=estimator)
    return Speed(
        photons,
        time.perf_counter() - clock,
        time.process_time() - processor,
        first.attrs["compile_seconds"],
        float(result.reflectance[0]),
        float(result.reflectance_se[0]),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--variant", choices=get_args(Variant), default="llvm")
    parser.add_argument("--estimator", choices=get_args(Estimator), default="expected")
    options = parser.parse_args()
    print("case   photons   M/s (clock)  M/s (processor s)  x MCML   1/(σ²t)   R ± SE (z)            compile s")
    for case in CASES:
        s = measure(case, options.seconds, options.variant, options.estimator)
        rate = s.photons / s.clock
        z = (s.value - case.reflectance) / s.error
        print(
            f"{case.name:4s} {s.photons:11,d} {rate / 1e6:9.2f} {s.photons / s.processor / 1e6:15.2f}"
            f" {rate / case.mcml:13.1f}   {s.merit:.3g}   {s.value:.6f} ± {s.error:.1e} ({z:+.1f})   {s.compile:.2f}"
        )


if __name__ == "__main__":
    main()
