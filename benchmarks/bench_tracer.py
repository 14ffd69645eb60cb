"""Seconds and memory of the tracer on a whole liver, full size or a part of its samples.

Run `python -m benchmarks.bench_tracer [--cases thesis measured capsule parenchyma] [--spp N] [--width W]
[--variant llvm_ad_spectral|cuda_ad_spectral]`. 960 × 540 pixels at 128 samples are the thesis's picture (45 minutes
there); with fewer samples the time is scaled up to it. Processor seconds are given as well: on a shared machine they
say more than the clock's. Then what one path for all wavelengths, and survival by weight, save: processor seconds to
equal error, as a ratio.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from livlab.model.shapes import distance_field, liver
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tracer import stage
from livlab.model.tracer.body import Body
from livlab.model.tracer.render import render
from livlab.model.tracer.variant import mitsuba

PRIMARIES_NM = (435.8, 546.1, 700.0)
FULL = 960 * 540 * 128
HOLD = {  # beyond their tables (index from 450 nm, lipid from 429 nm) both hold their ends
    "layers.parenchyma.index.outside": "hold",
    "layers.parenchyma.elements.lipid_and_water.parts.lipid.spectrum.outside": "hold",
}


@dataclass(frozen=True)
class Case:
    """A reading of some layers, wavelengths a channel, and the seconds it may take."""

    reading: str
    part: str
    each: int
    bar: float


CASES = {
    "thesis": Case("thesis", "whole", 5, 60.0),
    "measured": Case("measured", "whole", 5, 300.0),
    "capsule": Case("thesis", "capsule_only", 1, 15.0),
    "parenchyma": Case("thesis", "parenchyma_only", 1, 15.0),
    "capsule-measured": Case("measured", "capsule_only", 1, 15.0),
    "parenchyma-measured": Case("measured", "parenchyma_only", 1, 15.0),
}


def stack(case: Case) -> OpticalStack:
    """The tissue at κ = 20 nm, or at the primaries alone."""
    offsets = np.linspace(-20.0, 20.0, case.each) if case.each > 1 else np.zeros(1)
    grid = np.concatenate([primary + offsets for primary in PRIMARIES_NM])
    changes = {} if case.part == "capsule_only" else HOLD
    return optical_stack(load_preset("liver", variant=case.part, changes=changes), READINGS[case.reading], grid)


def scene(mi: Any, mesh: Any, width: int) -> Any:
    """A liver under a soft box and even light, as in the picture experiments."""
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": stage.sensor(
                mi, [-20, -330, 40], [0, 0, 0], [0, 0, 1], math.radians(30), width, round(width * 9 / 16)
            ),
            "body": stage.surface(mi, mesh),
            "lamp": stage.rectangle_light(mi, [-220, -300, 320], [0, 0, 0], [160, 160], 5.0),
            "around": stage.surrounding_light(mi, 0.15),
        },
        optimize=False,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=["thesis", "measured", "capsule", "parenchyma"])
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--variant", default="llvm_ad_spectral")
    given = parser.parse_args()
    mi = mitsuba(given.variant)
    mesh = liver()
    field = distance_field(mesh, 0.7)
    loaded = scene(mi, mesh, given.width)
    print(
        "case                 clock s  cpu s/2  compile  full, clock  full, cpu/2   bar  error of a sample  GiB  load"
    )
    for name in given.cases:
        case = CASES[name]
        tissue = stack(case)
        body = Body(tissue, "body", field)
        once = timed(loaded, body, given.spp, given.variant)
        scale = FULL / (given.width * round(given.width * 9 / 16) * given.spp)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"{name:20s} {once.clock:7.1f} {once.processor / 2:8.1f} {once.compile:8.1f} {once.clock * scale:12.0f} "
            f"{once.processor / 2 * scale:12.0f} {case.bar:5.0f} {once.error * math.sqrt(given.spp):18.2f} "
            f"{memory:4.1f} {os.getloadavg()[0]:5.1f}",
            flush=True,
        )
    small = scene(mi, mesh, given.width // 2)
    print("\nto equal error                                    processor seconds × error²   ratio")
    for name in ("thesis", "measured"):
        body = Body(stack(CASES[name]), "body", field)
        usual = timed(small, body, given.spp, given.variant).cost
        for what, settings in (("each wavelength alone", {"together": False}), ("analog", {"estimator": "analog"})):
            other = timed(small, body, given.spp, given.variant, **settings).cost
            print(f"{name}: {what:30s} {other:12.3g} against {usual:.3g} {other / usual:12.1f}", flush=True)


@dataclass(frozen=True)
class Timed:
    """Seconds by the clock, of all processors, of compiling; and the median relative error."""

    clock: float
    processor: float
    compile: float
    error: float

    @property
    def cost(self) -> float:
        """Processor seconds times squared error: it stays as samples grow."""
        return self.processor * self.error**2


def timed(loaded: Any, body: Body, spp: int, variant: str, **settings: Any) -> Timed:
    """Render once, tables and kernels made before."""
    grid = body.stack.wavelength_nm
    first = render(loaded, grid, body=body, spp=spp, seed=1, variant=variant, **settings)
    clock, processor = time.perf_counter(), time.process_time()
    out = render(loaded, grid, body=body, spp=spp, seed=2, variant=variant, **settings)
    clock, processor = time.perf_counter() - clock, time.process_time() - processor
    value, error = out["radiance"].to_numpy(), out["radiance_se"].to_numpy()
    # What sees only the even light has no error.
    seen = (value > 0.0) & (error.max(axis=-1, keepdims=True) > 0.0)
    return Timed(clock, processor, float(first.attrs["compile_seconds"]), float(np.median(error[seen] / value[seen])))


if __name__ == "__main__":
    main()
