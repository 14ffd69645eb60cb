"""Directions shared by layers of unequal index: nodes in the transverse sine s = n sinθ.

Refraction keeps s, so one grid of nodes serves every medium and an interface becomes a diagonal matrix.
A medium of index n holds the nodes with s < n. The grid breaks at every index that occurs (where light
turns totally reflected), and each interval is mapped by s² = a² + (b² − a²) sin²(πt/2) with Gauss–Legendre
nodes in t: in the medium of index b the cosine is then proportional to cos(πt/2), so the square roots at
a critical angle and the crowding of light at grazing directions are smooth in t, and convergence is fast.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from livlab.units import FloatArray

SAME_INDEX = 1e-9
"""Indices closer than this, relatively, are one: what they do to fluxes is of the same size, 1e-9."""

_NEAR = 0.1
"""Two indices are near if light at grazing incidence passes between them at a cosine below this."""


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
    """

    breaks: tuple[float, ...]
    counts: tuple[int, ...]
    beam: tuple[float, float]

    @classmethod
    def of(cls, indices: Iterable[float], nodes: int, beam: tuple[float, float]) -> AngularGrid:
        """Break at every index; a narrow interval gets fewer nodes than the `nodes` of a wide one."""
        breaks: list[float] = []
        for n in sorted(indices):
            if not breaks or n > breaks[-1] * (1.0 + SAME_INDEX):
                breaks.append(float(n))
        breaks = _graded(breaks)
        counts, low = [], 0.0
        for high in breaks:
            # Widest view of the interval: in the rarest medium that holds it, it ends at 90°.
            wide = math.acos(low / high) > 0.5
            counts.append(max(4, nodes if wide else math.ceil(0.75 * nodes)))
            low = high
        return cls(tuple(breaks), tuple(counts), beam)

    @property
    def size(self) -> int:
        """Number of nodes, the beam's included."""
        return 1 + sum(self.counts)

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
        parts, low = [np.zeros(1)], 0.0
        for high, count in zip(self.breaks, self.counts, strict=True):
            t, w = gauss_legendre(count)
            parts.append(w * (high - low) * (high + low) * 0.25 * math.pi * np.sin(math.pi * t))
            low = high
        return np.concatenate(parts)

    def cosines(self, n: float) -> FloatArray:
        """Cosines in a medium of index n of the nodes it holds, in the order of `active`."""
        beam = self.beam_cosine(n)
        parts = [] if beam is None else [np.array([beam])]
        low = 0.0
        for high, count in zip(self.breaks, self.counts, strict=True):
            if high <= n:
                parts.append(interval_cosines(n, low, high, gauss_legendre(count)[0]))
            low = high
        return np.concatenate(parts)


def _graded(breaks: list[float]) -> list[float]:
    """Further breaks where two indices nearly match.

    In the denser medium the cosine is then √(ε² + c²), c that in the rarer one: almost a corner, which
    intervals that grow geometrically from ε resolve.
    """
    graded: list[float] = []
    low = 0.0
    for b, denser in pairwise(breaks):
        epsilon = math.sqrt((denser - b) * (denser + b)) / denser
        widest = math.sqrt((b - low) * (b + low)) / b
        cuts, c = [], 4.0 * epsilon
        while epsilon < _NEAR and c < 0.5 * widest:
            cuts.append(b * math.sqrt((1.0 - c) * (1.0 + c)))
            c *= 8.0
        graded += [*reversed(cuts), b]
        low = b
    return [*graded, *breaks[-1:]]


def interval_cosines(n: float, low: float, high: float, t: FloatArray) -> FloatArray:
    """Cosines in a medium of index n ≥ high at places t of the interval (low, high) of the sine."""
    rest = (high - low) * (high + low) * np.cos(0.5 * math.pi * t) ** 2
    return np.minimum(np.sqrt((n - high) * (n + high) + rest) / n, 1.0)


def interval_place(low: float, high: float, sine: FloatArray) -> FloatArray:
    """Places t in [0, 1] of the given transverse sines in the interval (low, high)."""
    share = (sine - low) * (sine + low) / ((high - low) * (high + low))
    return np.arcsin(np.sqrt(np.clip(share, 0.0, 1.0))) * (2.0 / math.pi)


@lru_cache(maxsize=64)
def legendre_table(grid: AngularGrid, n: float, order: int) -> FloatArray:
    """Projections V[l, i] = ∫ ℓ_i(µ) P_l(µ) dµ on the nodes of a medium; (order + 1, nodes).

    ℓ_i is node i's cardinal function (a polynomial in t, zero outside the interval), integrated by a finer
    rule; for the beam, V[l] = P_l(µ₀). With them Σ_l (l + ½) χ_l V_li V_lj is the phase function
    averaged over both nodes' solid angles, however peaked it is.
    """
    beam = grid.beam_cosine(n)
    blocks = [] if beam is None else [(np.array([beam]), np.ones((1, 1)))]
    low = 0.0
    for high, count in zip(grid.breaks, grid.counts, strict=True):
        if high <= n:
            ends = interval_cosines(n, low, high, np.array([0.0, 1.0]))
            width = math.acos(ends[1]) - math.acos(min(ends[0], 1.0))
            t, w = gauss_legendre(8 * math.ceil((count + 20 + 0.45 * order * width) / 8))
            mu = interval_cosines(n, low, high, t)
            span = (high - low) * (high + low) * 0.25 * math.pi * np.sin(math.pi * t) / (n * n)
            blocks.append((mu, lagrange(count, t) * (w * span / mu)[:, None]))
        low = high
    mu = np.concatenate([b[0] for b in blocks])
    values = np.empty((order + 1, mu.size))
    values[0] = 1.0
    if order > 0:
        values[1] = mu
    for k in range(1, order):
        np.multiply(mu, values[k], out=values[k + 1])
        values[k + 1] *= (2 * k + 1) / (k + 1)
        values[k + 1] -= (k / (k + 1)) * values[k - 1]
    columns, start = [], 0
    for cosines, weights in blocks:
        columns.append(values[:, start : start + cosines.size] @ weights)
        start += cosines.size
    table: FloatArray = np.hstack(columns)
    table.setflags(write=False)
    return table
