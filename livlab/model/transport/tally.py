"""What a walk counts, and sums that keep their digits.

A photon carries single precision. A float32 sum stalls once it outgrows its terms by 2²⁴, and a sum shared
by threads depends on the order of their arrival; so contributions are added as integers, in units small
enough not to matter and over so few photons that nothing overflows, and the host goes on in double.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from livlab.errors import InputError
from livlab.units import FloatArray

FIXED_POINT = 2.0**36
"""Units a photon in bins that all lanes share: 64-bit integers hold 2²⁶ photons of a launch."""

LANE_FIXED_POINT = 2.0**22
"""Units a photon in a lane's own 32-bit register."""

LAUNCH_PHOTONS = 1 << 26
LANE_PHOTONS = 1 << 8
"""Photons of a launch and of a lane that leave either integer a bit to spare."""


@dataclass(frozen=True)
class Tally:
    """Bins of the light that leaves, on top of the totals.

    Attributes
    ----------
    theta_edges
        Edges of the exit angle in radians from the normal, outside the stack, increasing in [0, π/2].
        Empty: one bin over the hemisphere.
    radius_edges
        Edges of the exit point's distance from the origin in mm, increasing from ≥ 0; the last may be inf.
        Empty: one bin over the plane. Light beyond the edges counts in the totals only.
    phi_edges
        Edges of the exit direction's azimuth in radians, increasing in [0, π]: 0 is the side that collimated light
        comes from, π the side of its mirror image; left and right count alike. Asks for `reflectance_directed`.
    """

    theta_edges: tuple[float, ...] = ()
    radius_edges: tuple[float, ...] = ()
    phi_edges: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta_edges", _edges("tally.theta_edges", self.theta_edges, math.pi / 2))
        object.__setattr__(self, "radius_edges", _edges("tally.radius_edges", self.radius_edges, math.inf))
        object.__setattr__(self, "phi_edges", _edges("tally.phi_edges", self.phi_edges, math.pi))

    @property
    def binned(self) -> bool:
        """Whether there is anything to count beside totals."""
        return bool(self.theta_edges or self.radius_edges)

    @property
    def theta(self) -> tuple[float, ...]:
        """Edges in use."""
        return self.theta_edges or (0.0, math.pi / 2)

    @property
    def radius(self) -> tuple[float, ...]:
        """Edges in use."""
        return self.radius_edges or (0.0, math.inf)

    @property
    def minus_cosines(self) -> FloatArray:
        """−cos θ at the edges of `theta`, rising as θ does; the outermost take in what rounding puts beyond them."""
        edges = -np.cos(self.theta)
        edges[0] = -2.0 if self.theta[0] == 0.0 else edges[0]
        edges[-1] = 0.0 if self.theta[-1] >= math.pi / 2 else edges[-1]
        return np.asarray(edges)


def _edges(field: str, values: Sequence[float], top: float) -> tuple[float, ...]:
    edges = tuple(float(x) for x in values)
    if not edges:
        return ()
    rising = all(a < b for a, b in pairwise(edges))
    if len(edges) < 2 or not rising or edges[0] < 0.0 or edges[-1] > top * (1 + 1e-12):
        raise InputError.of(
            field, edges, f"must be two or more increasing edges within [0, {top:g}]", "Give the bins' edges in order."
        )
    return edges


@dataclass(frozen=True)
class SampleMoments:
    """Sum and sum of squares of one contribution a photon, over n photons.

    >>> m = SampleMoments.of(np.array([0.0, 1.0, 1.0, 0.0]))
    >>> float(m.mean), round(float(m.standard_error), 6)
    (0.5, 0.288675)
    """

    n: int
    total: FloatArray
    squares: FloatArray

    @classmethod
    def of(cls, values: FloatArray) -> SampleMoments:
        """From the contributions themselves, photons along the last axis."""
        v = np.asarray(values, dtype=np.float64)
        return cls(v.shape[-1], v.sum(-1), (v * v).sum(-1))

    @classmethod
    def from_mean(cls, n: int, mean: FloatArray, standard_error: FloatArray) -> SampleMoments:
        """The sums that a mean and its standard error came from."""
        mean = np.asarray(mean, dtype=np.float64)
        spread = np.asarray(standard_error, dtype=np.float64) ** 2 * (n - 1.0) * n if n > 1 else np.zeros_like(mean)
        return cls(n, mean * n, spread + n * mean**2)

    def __add__(self, other: SampleMoments) -> SampleMoments:
        return SampleMoments(self.n + other.n, self.total + other.total, self.squares + other.squares)

    @property
    def mean(self) -> FloatArray:
        """Mean a photon."""
        return np.asarray(self.total / self.n)

    @property
    def standard_error(self) -> FloatArray:
        """Standard error of the mean from the photons' own variance; NaN for a single photon."""
        if self.n < 2:
            return np.full_like(self.mean, math.nan)
        spread = np.maximum(self.squares - self.total**2 / self.n, 0.0)
        return np.asarray(np.sqrt(spread / (self.n - 1.0) / self.n))
