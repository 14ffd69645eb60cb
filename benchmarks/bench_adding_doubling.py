"""Adding–doubling: seconds per call and error against the nodes, on the cases the tests hold it to.

Run by `python -m benchmarks.bench_adding_doubling`. Seconds are the best of several calls, of wall clock and
of processor time; `cold` calls also build the tables that depend on the indices alone. The error is the
largest difference of the four totals from 64 nodes an interval.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from livlab.model.tissue.particles.sphere import mie_phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Phase
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.quadrature import legendre_table

TOTALS = ("reflectance", "transmittance", "reflectance_diffuse_incidence", "transmittance_diffuse_incidence")
COUNTS = (6, 8, 12, 16, 24, 32)


def cases() -> dict[str, OpticalStack]:
    g9 = HenyeyGreenstein(0.9)
    return {
        "i: slab, n 1, g .75": plain_stack([(1.0, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))]),
        "ii: half-space, n 1.5, g 0": plain_stack([(1.5, 1.0, 9.0, math.inf, Isotropic())]),
        "iii: two layers, g .9": plain_stack([(1.36, 0.01, 10.0, 0.1, g9), (1.38, 0.5, 15.0, 50.0, g9)]),
        "slab, g .98": plain_stack([(1.4, 0.05, 10.0, 1.0, HenyeyGreenstein(0.98))]),
        "slab, Mie x 25 (g .959)": plain_stack([(1.35, 0.5, 20.0, 1.0, mie_phase(1.5 / 1.35, 25.0))]),
        "slab, Mie x 100 (g .957)": plain_stack([(1.35, 0.5, 20.0, 1.0, mie_phase(1.5 / 1.35, 100.0))]),
        "slab, n 1 + 1e-6": plain_stack([(1 + 1e-6, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))]),
        "slab, depth 1e6, albedo 1": plain_stack([(1.4, 0.0, 1e6, 1.0, g9)]),
    }


def liver_like() -> OpticalStack:
    """Four sublayers of a capsule on parenchyma at 12 wavelengths, indices falling with wavelength."""
    wavelength = np.arange(500.0, 721.0, 20.0)
    one = np.ones_like(wavelength)
    dispersion = 0.01 * (600.0 - wavelength) / 100.0

    def layer(name: str, thickness: float, n: float, mua: float, mus: float, phase: Phase) -> PlaneLayer:
        phases = (phase,) * len(wavelength)
        parts = (Interaction("absorber", mua * one, 0 * one, phases), Interaction("scatterer", mus * one, one, phases))
        return PlaneLayer(name, thickness, n + dispersion, parts)

    fibres, cells = mie_phase(1.5 / 1.35, 25.0), HenyeyGreenstein(0.9)
    return OpticalStack(
        wavelength,
        (
            layer("capsule 1", 0.065, 1.35, 0.01, 20.0, fibres),
            layer("capsule 2", 0.007, 1.35, 0.01, 25.0, fibres),
            layer("capsule 3", 0.011, 1.35, 0.01, 25.0, cells),
            layer("capsule 4", 0.017, 1.35, 0.01, 8.0, fibres),
            layer("parenchyma", 140.0, 1.383, 0.3, 10.0, cells),
        ),
        one,
        one,
    )


def best(call: Callable[[], xr.Dataset], repeats: int = 7) -> tuple[float, float]:
    """Least wall-clock and processor seconds."""
    wall, cpu = [], []
    for _ in range(repeats):
        start, busy = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - busy)
    return min(wall), min(cpu)


def cold(stack: OpticalStack) -> xr.Dataset:
    legendre_table.cache_clear()
    return adding_doubling(stack)


def crossing(gap: float) -> OpticalStack:
    """Two layers whose indices differ by a gap, as where dispersion curves cross."""
    first, second = HenyeyGreenstein(0.8), HenyeyGreenstein(0.9)
    return plain_stack([(1.4, 0.1, 10.0, 0.5, first), (1.4 + gap, 0.2, 5.0, 1.0, second)])


def near_indices() -> Table:
    """What nearly equal indices cost against equal ones."""
    table = Table("gap", "nodes", "ms", "times the equal ones'", title="two layers whose indices nearly match")
    equal, _ = best(lambda: adding_doubling(crossing(0.0)))
    for gap in (0.0, 1e-12, 1e-8, 1e-6, 1e-4, 1e-2):
        wall, _ = best(lambda g=gap: adding_doubling(crossing(g)))
        nodes = int(adding_doubling(crossing(gap)).nodes[0])
        table.add_row(f"{gap:g}", str(nodes), f"{1e3 * wall:.1f}", f"{wall / equal:.1f}")
    return table


def main() -> None:
    console = Console(width=110)
    nodes = Table("case", *(f"{n} nodes" for n in COUNTS), title="error, milliseconds at a fixed node count")
    adaptive = Table(
        "case", "nodes", "estimate", "error", "ms", "ms cpu", "ms cold", title="default call, tolerance 1e-6"
    )
    for name, stack in cases().items():
        truth = adding_doubling(stack, nodes=64, tolerance=1e-9)

        def error(result: xr.Dataset, truth: xr.Dataset = truth) -> float:
            return max(float(np.abs(result[x] - truth[x]).max()) for x in TOTALS)

        row = []
        for count in COUNTS:
            wall, _ = best(lambda s=stack, n=count: adding_doubling(s, nodes=n), 3)
            row.append(f"{error(adding_doubling(stack, nodes=count)):.0e} {1e3 * wall:4.0f}")
        nodes.add_row(name, *row)
        result = adding_doubling(stack)
        wall, cpu = best(lambda s=stack: adding_doubling(s))
        first, _ = best(lambda s=stack: cold(s), 3)
        adaptive.add_row(
            name,
            str(int(result.nodes[0])),
            f"{float(result.error_estimate[0]):.0e}",
            f"{error(result):.0e}",
            f"{1e3 * wall:.1f}",
            f"{1e3 * cpu:.1f}",
            f"{1e3 * first:.1f}",
        )
    stack = liver_like()
    result = adding_doubling(stack)
    wall, cpu = best(lambda: cold(stack), 3)
    console.print(nodes)
    console.print(adaptive)
    console.print(near_indices())
    console.print(
        f"12 wavelengths of 5 layers: {wall:.2f} s ({cpu:.2f} s of processor time), "
        f"estimate {float(result.error_estimate.max()):.0e}. A fixed node count also solves two thirds of it."
    )


if __name__ == "__main__":
    main()
