"""Directions shared by layers of unequal index: nodes in the transverse sine s = n sinθ.

Refraction keeps s, so one grid of nodes serves every medium and an interface becomes a diagonal matrix.
A medium of index n holds the nodes with s < n. The grid breaks at every index that occurs (where light
turns totally reflected), and each interval is mapped by s² = a² + (b² − a²) sin²(πt/2) with Gauss–Legendre
nodes in t: in the medium of index b the cosine is then proportional to cos(πt/2), so the square roots at
a critical angle and the crowding of light at grazing directions are smooth in t, and convergence is fast.

Where the next index d is nearly b, the cosine in the denser medium is √(ε² + c²), c that in the rarer one and
ε² = d² − b²: almost a corner. There b² − s² = ε² sinh² u, u = U (1 − t²): both cosines, ε sinh u and ε cosh u, are
smooth in u on every scale from ε on, and the square root at a is one in t.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from livlab.units import FloatArray

SAME_INDEX = 1e-9
"""Indices closer than this, relatively, are one: what they do to fluxes is of the same size, 1e-9."""

_NEAR = 0.3
"""Two indices are near if light at grazing incidence passes between them at a cosine below this."""

_SHARPEST = 1e-3
"""Least ε that is resolved, over the index: corners smaller than it hold less than a millionth of the light."""

_SOFT_NODES = 0.1
"""Nodes more, as a share, that a near corner takes for each factor e between its own scale and the interval's."""

_BEYOND = 3.0
"""A node is a point if a projection exceeds its solid angle, which bounds |P_l|'s, by more than this factor."""

_LITTLE = 1e-2
"""Share of an interval's flux from which on it is a small one."""

_DECAY = 1.15
"""Logarithm of what one node more takes from the error, at least: 1/√10."""


@lru_cache(maxsize=256)
def gauss_legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of Gauss–Legendre quadrature on (0, 1); both (count,)."""
    x, w = np.polynomial.legendre.leggauss(count)
    nodes, weights = 0.5 * (x + 1.0), 0.5 * w
    nodes.setflags(write=False)
    weights.setflags(write=False)
    return nodes, weights


def lagrange(count: int, at: FloatArray) -> FloatArray:
    """Values (len(at), count) of the cardinal polynomials of the `count` Gauss–Legendre nodes on (0, 1).

    Barycentric form with the weights (−1)^i √(t_i (1 − t_i) w_i) (Wang, Huybrechs & Vandewalle 2014).
    """
    nodes, weights = gauss_legendre(count)
    bary = np.sqrt(nodes * (1.0 - nodes) * weights)
    bary[1::2] *= -1.0
    gap = at[:, None] - nodes
    hit = gap == 0.0
    terms = bary / np.where(hit, 1.0, gap)
    values: FloatArray = terms / terms.sum(axis=1, keepdims=True)
    rows = hit.any(axis=1)
    values[rows] = hit[rows]
    return values


@dataclass(frozen=True)
class SineInterval:
    """One interval of the sine, (low, high), and its variable t on (0, 1).

    Attributes
    ----------
    low, high
        Its ends.
    soft
        ε = √(d² − high²) if the next index d is nearly `high`, else 0.
    """

    low: float
    high: float
    soft: float = 0.0

    @property
    def _area(self) -> float:
        return (self.high - self.low) * (self.high + self.low)

    @property
    def reach(self) -> float:
        """U, the range of u next to a near corner."""
        return math.asinh(math.sqrt(self._area) / self.soft)

    def rest(self, t: FloatArray) -> FloatArray:
        """high² − s² at places t."""
        if self.soft == 0.0:
            return np.asarray(self._area * np.cos(0.5 * math.pi * t) ** 2)
        return np.asarray(self.soft**2 * np.sinh(self.reach * (1.0 - t * t)) ** 2)

    def flux(self, t: FloatArray) -> FloatArray:
        """S ds/dt at places t."""
        if self.soft == 0.0:
            return np.asarray(self._area * 0.25 * math.pi * np.sin(math.pi * t))
        reach = self.reach
        return np.asarray(self.soft**2 * reach * t * np.sinh(2.0 * reach * (1.0 - t * t)))

    def cosines(self, n: float, t: FloatArray) -> FloatArray:
        """Cosines in a medium of index n ≥ high at places t."""
        return np.minimum(np.sqrt((n - self.high) * (n + self.high) + self.rest(t)) / n, 1.0)

    def place(self, sine: FloatArray) -> FloatArray:
        """Places t in [0, 1] of the given transverse sines."""
        if self.soft == 0.0:
            share = (sine - self.low) * (sine + self.low) / self._area
            return np.arcsin(np.sqrt(np.clip(share, 0.0, 1.0))) * (2.0 / math.pi)
        rest = np.clip((self.high - sine) * (self.high + sine), 0.0, self._area)
        share = np.arcsinh(np.sqrt(rest) / self.soft) / self.reach
        return np.asarray(np.sqrt(np.clip(1.0 - share, 0.0, 1.0)))


@dataclass(frozen=True)
class AngularGrid:
    """Nodes of the transverse sine: a beam of zero width first, then the intervals' nodes.

    Attributes
    ----------
    breaks
        Upper ends of the intervals, ascending: the indices of the stack.
    counts
        Nodes in each interval.
    beam
        Index of the medium that the beam comes from and its cosine there; its node has no weight.
    soft
        ε of each interval (`SineInterval`); none: 0 for all.
    """

    breaks: tuple[float, ...]
    counts: tuple[int, ...]
    beam: tuple[float, float]
    soft: tuple[float, ...] = ()

    @classmethod
    def of(cls, indices: Iterable[float], nodes: int, beam: tuple[float, float]) -> AngularGrid:
        """Break at every index; a narrow interval gets fewer nodes than the `nodes` of a wide one."""
        breaks: list[float] = []
        for n in sorted(indices):
            if not breaks or n > breaks[-1] * (1.0 + SAME_INDEX):
                breaks.append(float(n))
        counts, soft, low = [], [], 0.0
        for high, denser in zip(breaks, [*breaks[1:], math.inf], strict=True):
            soft.append(_softness(low, high, denser))
            # Widest view of the interval: in the rarest medium that holds it, it ends at 90°.
            wide = math.acos(low / high) > 0.5
            count = nodes if wide else math.ceil(0.75 * nodes)
            share = (high - low) * (high + low) / (high * high)
            if share < _LITTLE:
                # Little light goes there, which may be less exact by as much.
                count = math.ceil(count + math.log(share / _LITTLE) / _DECAY)
            if soft[-1]:
                count = math.ceil(count * (1.0 + _SOFT_NODES * SineInterval(low, high, soft[-1]).reach))
            counts.append(max(4, count))
            low = high
        return cls(tuple(breaks), tuple(counts), beam, tuple(soft))

    @property
    def size(self) -> int:
        """Number of nodes, the beam's included."""
        return 1 + sum(self.counts)

    @property
    def intervals(self) -> list[tuple[SineInterval, int]]:
        """The intervals, ascending, and how many nodes each has."""
        lows = (0.0, *self.breaks[:-1])
        soft = self.soft or (0.0,) * len(self.breaks)
        made = [SineInterval(*x) for x in zip(lows, self.breaks, soft, strict=True)]
        return list(zip(made, self.counts, strict=True))

    def snap(self, n: float) -> float:
        """The break that stands for the index n."""
        return min(self.breaks, key=lambda b: abs(b - n))

    def beam_cosine(self, n: float) -> float | None:
        """The beam's cosine in a medium of index n, or None where it cannot go."""
        origin, mu = self.beam
        squared = ((n - origin) * (n + origin) + (origin * mu) ** 2) / (n * n)
        return min(math.sqrt(squared), 1.0) if squared > 1e-20 else None

    def active(self, n: float) -> NDArray[np.intp]:
        """Indices of the nodes that travel in a medium of index n (a break)."""
        held = sum(c for b, c in zip(self.breaks, self.counts, strict=True) if b <= n)
        first = 1 if self.beam_cosine(n) is None else 0
        return np.arange(first, held + 1)

    def flux(self) -> FloatArray:
        """(size,) ∫ s ds of each node: its share of an isotropic radiance's flux, in every medium."""
        parts = [np.zeros(1)]
        for interval, count in self.intervals:
            t, w = gauss_legendre(count)
            parts.append(w * interval.flux(t))
        return np.concatenate(parts)

    def cosines(self, n: float) -> FloatArray:
        """Cosines in a medium of index n of the nodes it holds, in the order of `active`."""
        beam = self.beam_cosine(n)
        parts = [] if beam is None else [np.array([beam])]
        parts += [i.cosines(n, gauss_legendre(count)[0]) for i, count in self.intervals if i.high <= n]
        return np.concatenate(parts)


def _softness(low: float, high: float, denser: float) -> float:
    """ε of an interval next to one of nearly its index, 0 if there is no such, or the interval itself is as narrow."""
    if not math.isfinite(denser):
        return 0.0
    epsilon = max(math.sqrt((denser - high) * (denser + high)), _SHARPEST * denser)
    return epsilon if epsilon < _NEAR * denser and 2.0 * epsilon < math.sqrt((high - low) * (high + low)) else 0.0


@lru_cache(maxsize=64)
def legendre_table(grid: AngularGrid, n: float, order: int) -> FloatArray:
    """Projections V[l, i] = ∫ ℓ_i(µ) P_l(µ) dµ on the nodes of a medium; (order + 1, nodes).

    ℓ_i is node i's cardinal function (a polynomial in t, zero outside the interval), integrated by a finer
    rule; for the beam, V[l] = P_l(µ₀). With them Σ_l (l + ½) χ_l V_li V_lj is the phase function
    averaged over both nodes' solid angles, however peaked it is.
    """
    beam = grid.beam_cosine(n)
    blocks = [] if beam is None else [(np.array([beam]), np.ones((1, 1)))]
    for interval, count in grid.intervals:
        if interval.high <= n:
            ends = interval.cosines(n, np.array([0.0, 1.0]))
            width = math.acos(ends[1]) - math.acos(min(ends[0], 1.0))
            fine = 0.45 if interval.soft == 0.0 else 0.9
            t, w = gauss_legendre(8 * math.ceil((count + 20 + fine * order * width) / 8))
            mu = interval.cosines(n, t)
            weights = lagrange(count, t) * (w * interval.flux(t) / (n * n) / mu)[:, None]
            blocks.append((mu, weights))
    values = _polynomials(order, np.concatenate([b[0] for b in blocks]))
    columns, start = [], 0
    for cosines, weights in blocks:
        columns.append(values[:, start : start + cosines.size] @ weights)
        start += cosines.size
    table: FloatArray = np.hstack(columns)
    if any(grid.soft):
        _mend_corners(table, grid, n)
    table.setflags(write=False)
    return table


def _polynomials(order: int, mu: FloatArray) -> FloatArray:
    """(order + 1, len(mu)) Legendre polynomials, by recurrence."""
    values = np.empty((order + 1, mu.size))
    values[0] = 1.0
    if order > 0:
        values[1] = mu
    for k in range(1, order):
        np.multiply(mu, values[k], out=values[k + 1])
        values[k + 1] *= (2 * k + 1) / (k + 1)
        values[k + 1] -= (k / (k + 1)) * values[k - 1]
    return values


def _mend_corners(table: FloatArray, grid: AngularGrid, n: float) -> None:
    """Take nodes for points where their solid angle is lost in what the integrals of their interval are off.

    Next to a near corner solid angles of an interval differ by many powers of ten; scattering into the smallest, which
    divides by them, would be beyond all bounds.
    """
    active = grid.active(n)
    cosines = grid.cosines(n)
    solid = grid.flux()[active] / (n * n * cosines)
    lost = np.flatnonzero((solid > 0.0) & (np.abs(table).max(axis=0) > _BEYOND * solid))
    if lost.size:
        table[:, lost] = _polynomials(len(table) - 1, cosines[lost]) * solid[lost]
