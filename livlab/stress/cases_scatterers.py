"""Runners for spheres, cylinders and phase functions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from livlab.model.tissue.particles.cylinder import cylinder as solve_cylinder
from livlab.model.tissue.particles.cylinder import cylinder_mean as solve_cylinder_mean
from livlab.model.tissue.particles.sphere import mie as solve_sphere
from livlab.model.tissue.particles.sphere import mie_phase
from livlab.model.tissue.phase.functions import PhaseFunction, Tabulated, kernel_table
from livlab.stress.inputs import phase as made_phase
from livlab.stress.measured import Measured, index, runner, values


@runner
def mie(m: list[float], x: list[float]) -> dict[str, Measured]:
    """Efficiencies of spheres over sizes."""
    found = solve_sphere(index(m), np.array(x))
    return values(q_ext=found.q_ext, q_sca=found.q_sca, anisotropy=found.anisotropy)


@runner
def mie_steps(m: list[float], x: float, step: float) -> dict[str, Measured]:
    """Largest relative jump where one way of computing hands over to the next, at x (1 ± step)."""
    below, above = (solve_sphere(index(m), x * (1.0 + s * step)) for s in (-1.0, 1.0))
    jumps = [abs(float(a) / float(b) - 1.0) for a, b in zip(below, above, strict=True)]
    return values(jump=max(jumps))


@runner
def mie_lobes(m: list[float], x: list[float]) -> dict[str, Measured]:
    """Forward over sideward scattering, mass of the phase function less 1, and anisotropy, over sizes."""
    made = [mie_phase(index(m), size) for size in x]
    ratio = [float(p.pdf(np.array(1.0)) / p.pdf(np.array(0.0))) for p in made]
    mass = [float(p.cdf(np.array(1.0))) for p in made]
    return values(forward_over_side=ratio, mass=mass, anisotropy=[p.anisotropy for p in made])


@runner
def cylinder(m: list[float], x: float | list[float], zeta: float | list[float]) -> dict[str, Measured]:
    """Efficiencies of cylinders, unpolarised."""
    found = solve_cylinder(index(m), np.array(x), np.array(zeta))
    return values(q_ext=found.q_ext, q_sca=found.q_sca, anisotropy=found.anisotropy)


@runner
def cylinder_mean(m: list[float], x: list[float]) -> dict[str, Measured]:
    """Their mean over orientations."""
    found = solve_cylinder_mean(index(m), np.array(x))
    return values(q_ext=found.q_ext, q_sca=found.q_sca, anisotropy=found.anisotropy)


@runner
def quantile(phase: list[Any], v: list[float]) -> dict[str, Measured]:
    """1 − cos θ at shares of the scattered light."""
    made = made_phase(phase)
    assert isinstance(made, PhaseFunction)
    return values(complement=made.quantile_complement(np.array(v)))


@runner
def phase_ends(phase: list[Any]) -> dict[str, Measured]:
    """A phase function at the ends of its arguments.

    `outside`: samples not finite or off [−1, 1] at the first and last random numbers of either precision.
    `round_trip`: |cdf(sample(u)) − u|. `mass`: its integral. `order_one`: χ_1 less g.
    """
    made = _peaked(float(phase[1])) if phase[0] == "peak" else made_phase(phase)
    u = np.array([0.0, 5e-324, 2.0**-53, 2.0**-24, 0.25, 0.5, 0.75, 1.0 - 2.0**-24, 1.0 - 2.0**-53])
    drawn = made.sample(u)
    outside = np.count_nonzero(~((drawn >= -1.0) & (drawn <= 1.0)))
    ends = made.pdf(np.array([-1.0, 1.0]))
    return values(
        outside=outside + np.count_nonzero(~np.isfinite(ends)),
        falls=np.count_nonzero(np.diff(drawn) < 0.0),
        round_trip=np.abs(made.cdf(drawn) - u).max(),
        mass=float(made.cdf(np.array(1.0))),
        order_one=float(made.legendre(1)[1]) - made.anisotropy,
        not_finite=np.count_nonzero(~np.isfinite(made.legendre(64))),
    )


@runner
def peak(width: list[float]) -> dict[str, Measured]:
    """1 − g of peaks that are given by a table, and of the table that a kernel in single precision samples."""
    made = [_peaked(w) for w in width]
    moment = [1.0 - p.anisotropy for p in made]
    tabled = [1.0 - kernel_table(p, per_octave=128).anisotropy for p in made]
    return values(one_less_anisotropy=moment, kernel_table=tabled)


@runner
def device_samplers(phases: list[list[Any]]) -> dict[str, Measured]:
    """The kernel's samplers at every end of a random number, in single precision.

    `outside`: values of 1 − cos θ not within [0, 2]. `difference`: largest difference from the double-precision
    quantile; tables interpolate, which is counted apart as the shift in probability that it means.
    """
    from livlab.model.transport.device import device
    from livlab.model.transport.rng import uniform
    from livlab.model.transport.walk import events as walk_events
    from livlab.model.transport.walk.tables import tables

    d = device("llvm")
    bits = d.UInt32([0, 1, 255, 256, 511, 1 << 30, 1 << 31, (1 << 31) - 1, 3 << 30, 0xFFFFFEFF, 0xFFFFFFFF])
    u = uniform(d, bits)
    host = np.array(u, dtype=np.float64)
    outside, apart, shift = 0, 0.0, 0.0
    for spec in phases:
        made = mie_phase(complex(spec[1]), float(spec[2])) if spec[0] == "mie" else made_phase(spec)
        t = tables(_scattering(made), "expected")
        column = d.load(d.Float, t.table)
        kind, offset = d.UInt32(int(t.kind[0, 0, 0])), d.UInt32(int(t.offset[0, 0, 0]))
        w = np.array(walk_events.polar(d, t, column, kind, d.Float(float(t.g[0, 0, 0])), offset, u), dtype=np.float64)
        outside += int(np.count_nonzero(~((w >= 0.0) & (w <= 2.0))))
        assert isinstance(made, PhaseFunction)
        if spec[0] == "mie":
            inside = np.clip(w, 0.0, 2.0)
            shift = max(shift, float(np.abs(1.0 - made.cdf_complement(inside) - host).max()))
        else:
            apart = max(apart, float(np.abs(w - made.quantile_complement(1.0 - host)).max()))
    return values(outside=outside, difference=apart, probability=shift)


@runner
def draws(rates: list[float]) -> dict[str, Measured]:
    """How often the rare one of two exponential draws is the shortest, counted over the draws' own 2^32 values.

    The share is Σ over the rare element's draws of the chance that the other's is longer; no random number is
    used. `rare`: its ratio to rate/Σ rates; `not_finite`: draws that are no positive number.
    """
    from livlab.model.transport.device import device
    from livlab.model.transport.rng import exponential

    d = device("llvm")
    rare, common = rates
    # All short draws one by one (they decide), then groups of ever more.
    top = 1 << 32
    edges = np.unique(np.concatenate([np.arange(1 << 12), np.geomspace(1 << 12, top, 1 << 18).astype(np.int64)]))
    middle = (edges[:-1] + edges[1:] - 1) // 2
    bits = (top - 1 - middle).astype(np.uint32)
    drawn = np.array(exponential(d, d.UInt32(bits)), dtype=np.float64)
    ends = np.array(exponential(d, d.UInt32([0, 1, top - 2, top - 1])), dtype=np.float64)
    weight = np.diff(edges) / top
    found = float(np.sum(weight * np.exp(-drawn / rare * common)))
    bad = [np.count_nonzero(~(np.isfinite(x) & (x > 0.0))) for x in (drawn, ends)]
    return values(rare=found / (rare / (rare + common)), not_finite=sum(bad))


def _scattering(phase: Any) -> Any:
    from livlab.model.tissue.stack import plain_stack

    return plain_stack([(1.0, 0.0, 1.0, math.inf, phase)])


def _peaked(width: float) -> Tabulated:
    """A peak that falls linearly over `width` in 1 − cos θ to a floor a millionth as high."""
    return Tabulated.from_complement([0.0, width, 2.0], [1.0, 1e-6, 1e-6])
