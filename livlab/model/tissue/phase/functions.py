"""Phase functions: isotropic, Rayleigh, Henyey–Greenstein, tabulated, and their mixtures.

Each is immutable, hashable and comparable, so that caches can key on it, and satisfies
`livlab.model.tissue.phase.base.Phase`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.phase.base import Phase, PhaseFunction, checked_order
from livlab.model.tissue.phase.kernel import KernelTable, kernel_table
from livlab.model.tissue.phase.tabulated import Tabulated
from livlab.units import FloatArray

__all__ = [
    "HenyeyGreenstein",
    "Isotropic",
    "KernelTable",
    "PhaseFunction",
    "PhaseMixture",
    "Rayleigh",
    "Tabulated",
    "kernel_table",
    "mixture",
]


@dataclass(frozen=True)
class Isotropic(PhaseFunction):
    """Equal in all directions, p = 1/(4π).

    >>> Isotropic().sample(np.array([0.0, 0.25, 0.5]))
    array([-1. , -0.5,  0. ])
    """

    @property
    def anisotropy(self) -> float:
        """Mean cosine, 0."""
        return 0.0

    def pdf_complement(self, w: FloatArray) -> FloatArray:
        """Value per steradian, 1/(4π)."""
        return np.full_like(np.asarray(w, dtype=np.float64), 0.25 / math.pi)

    def cdf_complement(self, w: FloatArray) -> FloatArray:
        """Probability that 1 − cos θ is at most w: w/2."""
        return 0.5 * np.asarray(w, dtype=np.float64)

    def quantile_complement(self, v: FloatArray) -> FloatArray:
        """The w below which 1 − cos θ falls with probability v: 2v."""
        return 2.0 * np.asarray(v, dtype=np.float64)

    def legendre(self, order: int) -> FloatArray:
        """Moments 1, 0, 0 and so on."""
        return _leading(order, 1.0)


@dataclass(frozen=True)
class Rayleigh(PhaseFunction):
    """Dipole scattering of unpolarised light, p = 3/(16π) (1 + cos²θ) (Nunes 2019, eq. 3.12).

    >>> round(float(Rayleigh().pdf(np.array(1.0))) * 8 * math.pi, 12)
    3.0
    """

    @property
    def anisotropy(self) -> float:
        """Mean cosine, 0 by symmetry."""
        return 0.0

    def pdf_complement(self, w: FloatArray) -> FloatArray:
        """Value per steradian at cos θ = 1 − w."""
        return 3.0 / (16.0 * math.pi) * (1.0 + (1.0 - np.asarray(w, dtype=np.float64)) ** 2)

    def cdf_complement(self, w: FloatArray) -> FloatArray:
        """Probability that 1 − cos θ is at most w: (3/8) (2w − w² + w³/3)."""
        w = np.asarray(w, dtype=np.float64)
        return 0.375 * w * (2.0 - w + w * w / 3.0)

    def quantile_complement(self, v: FloatArray) -> FloatArray:
        """Inverse by Cardano: µ³ + 3µ = 8u − 4 has the one real root µ = 2 sinh(asinh(4u − 2)/3)."""
        v = np.asarray(v, dtype=np.float64)
        w = 1.0 - 2.0 * np.sinh(np.arcsinh(2.0 - 4.0 * v) / 3.0)
        slope = 0.375 * (2.0 - 2.0 * w + w * w)  # one Newton step: near w = 0 the closed form cancels
        w = w - (self.cdf_complement(w) - v) / slope
        return np.asarray(np.clip(w, 0.0, 2.0))

    def legendre(self, order: int) -> FloatArray:
        """Moments 1, 0, 1/10, 0 and so on."""
        return _leading(order, 1.0, 0.0, 0.1)


@dataclass(frozen=True)
class HenyeyGreenstein(PhaseFunction):
    """p = (1 − g²) / (4π (1 + g² − 2g cos θ)^(3/2)) (Henyey & Greenstein 1941, Astrophys. J. 93:70).

    All forms are free of cancellation: g = 0 is the isotropic limit, |g| = 0.9999 keeps its digits.

    Parameters
    ----------
    g
        Anisotropy, −1 < g < 1.

    Raises
    ------
    InputError
        If g is outside (−1, 1) or NaN.
    """

    g: float

    def __post_init__(self) -> None:
        if not -1.0 < self.g < 1.0:
            raise InputError.of(
                "HenyeyGreenstein.g", self.g, "must lie strictly between -1 and 1", "Give the mean cosine."
            )

    @property
    def anisotropy(self) -> float:
        """Mean cosine, g itself."""
        return float(self.g)

    def _root(self, w: FloatArray) -> FloatArray:
        """√(1 + g² − 2g cos θ), as a sum of two terms ≥ 0."""
        g = self.g
        if g >= 0.0:
            return np.asarray(np.sqrt((1.0 - g) ** 2 + 2.0 * g * w))
        return np.asarray(np.sqrt((1.0 + g) ** 2 - 2.0 * g * (2.0 - w)))

    def pdf_complement(self, w: FloatArray) -> FloatArray:
        """Value per steradian at cos θ = 1 − w."""
        s = self._root(np.asarray(w, dtype=np.float64))
        return (1.0 - self.g) * (1.0 + self.g) / (4.0 * math.pi * s**3)

    def cdf_complement(self, w: FloatArray) -> FloatArray:
        """Probability that 1 − cos θ is at most w: (1 + g) w / (s (1 − g + s)), s² = 1 + g² − 2g cos θ."""
        w = np.asarray(w, dtype=np.float64)
        s = self._root(w)
        return (1.0 + self.g) * w / (s * (1.0 - self.g + s))

    def quantile_complement(self, v: FloatArray) -> FloatArray:
        """Closed form 2 (1 − g)² v (1 + g − g v) / (1 + g − 2 g v)²."""
        v = np.asarray(v, dtype=np.float64)
        g = self.g
        # 1 + g − 2 g v and 1 + g − g v, each as a sum of terms ≥ 0.
        far = (1.0 - g) + 2.0 * g * (1.0 - v) if g >= 0.0 else (1.0 + g) - 2.0 * g * v
        near = 1.0 + g * (1.0 - v) if g >= 0.0 else (1.0 + g) - g * v
        w = 2.0 * (1.0 - g) ** 2 * v * near / far**2
        return np.asarray(np.minimum(w, 2.0))

    def legendre(self, order: int) -> FloatArray:
        """Moments χ_l = g^l."""
        return np.asarray(float(self.g) ** np.arange(checked_order(order) + 1))


@dataclass(frozen=True)
class PhaseMixture(PhaseFunction):
    """Σ f_i p_i with shares f_i that sum to 1; make it by `mixture`, which simplifies.

    Attributes
    ----------
    phases
        At least one phase function.
    weights
        Their shares, positive, summing to 1.
    """

    phases: tuple[Phase, ...]
    weights: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.phases or len(self.phases) != len(self.weights):
            raise InputError.of(
                "PhaseMixture.weights",
                self.weights,
                f"must hold one share for each of {len(self.phases)} phases",
                "Match.",
            )
        if not all(f > 0 for f in self.weights) or abs(math.fsum(self.weights) - 1.0) > 1e-12:
            raise InputError.of("PhaseMixture.weights", self.weights, "must be > 0 and sum to 1", "Use mixture().")

    @property
    def anisotropy(self) -> float:
        """Mean cosine: the shares' mean."""
        return math.fsum(f * p.anisotropy for f, p in zip(self.weights, self.phases, strict=True))

    def pdf_complement(self, w: FloatArray) -> FloatArray:
        """Value per steradian at cos θ = 1 − w."""
        w = np.asarray(w, dtype=np.float64)
        parts = [
            f * (p.pdf_complement(w) if isinstance(p, PhaseFunction) else p.pdf(1.0 - w))
            for f, p in zip(self.weights, self.phases, strict=True)
        ]
        return np.asarray(sum(parts))

    def cdf_complement(self, w: FloatArray) -> FloatArray:
        """Probability that 1 − cos θ is at most w."""
        w = np.asarray(w, dtype=np.float64)
        parts = [
            f * (p.cdf_complement(w) if isinstance(p, PhaseFunction) else 1.0 - p.cdf(1.0 - w))
            for f, p in zip(self.weights, self.phases, strict=True)
        ]
        return np.asarray(sum(parts))

    def quantile_complement(self, v: FloatArray) -> FloatArray:
        """The w whose distribution is v: Newton, kept inside a bracket of the parts' own quantiles."""
        v = np.asarray(v, dtype=np.float64)
        ends = [
            p.quantile_complement(v) if isinstance(p, PhaseFunction) else 1.0 - p.sample(np.minimum(1.0 - v, 1.0))
            for p in self.phases
        ]
        low, high = np.minimum.reduce(ends), np.maximum.reduce(ends)
        w = 0.5 * (low + high)
        for _ in range(200):
            excess = self.cdf_complement(w) - v
            low = np.where(excess < 0.0, w, low)
            high = np.where(excess > 0.0, w, high)
            done = (excess == 0.0) | (high - low <= 4e-16 * high)
            if done.all():
                break
            with np.errstate(divide="ignore", invalid="ignore"):
                newton = w - excess / (2.0 * math.pi * self.pdf_complement(w))
            inside = (newton > low) & (newton < high)
            # A geometric halving crosses the decades between a peak and its tail; near 0 it needs a plain one.
            halved = np.where(low > 0.0, np.sqrt(low * high), 0.5 * (low + high))
            w = np.where(done, w, np.where(inside, newton, halved))
        return np.asarray(w)

    def legendre(self, order: int) -> FloatArray:
        """Moments: the shares' mean of the parts' moments."""
        parts = [f * p.legendre(order) for f, p in zip(self.weights, self.phases, strict=True)]
        return np.asarray(sum(parts))


def mixture(phases: Sequence[Phase], weights: Sequence[float]) -> Phase:
    """The phase function of several scatterers, weighted by their scattering coefficients.

    Weights of 0 are dropped, equal phases merged, nested mixtures opened; one phase left is returned as it
    is, none gives `Isotropic()` (nothing scatters, the direction never matters).

    Parameters
    ----------
    phases
        The parts.
    weights
        Scattering coefficients or any shares ≥ 0, one for each phase; they need not sum to 1.

    Raises
    ------
    InputError
        If the lengths differ or a weight is negative or not finite.

    Examples
    --------
    >>> mixture([HenyeyGreenstein(0.9), Isotropic()], [3.0, 1.0]).anisotropy
    0.675
    >>> mixture([HenyeyGreenstein(0.9), HenyeyGreenstein(0.9), Isotropic()], [3.0, 1.0, 0.0])
    HenyeyGreenstein(g=0.9)
    """
    if len(phases) != len(weights):
        raise InputError.of("weights", list(weights), f"must have {len(phases)} entries, one a phase", "Match them.")
    merged: dict[Phase, float] = {}
    for phase, weight in zip(phases, weights, strict=True):
        if not (weight >= 0.0 and math.isfinite(weight)):
            raise InputError.of("weights", weight, "must be finite and >= 0", "Give scattering coefficients.")
        if weight == 0.0:
            continue
        inner = (
            zip(phase.phases, phase.weights, strict=True) if isinstance(phase, PhaseMixture) else iter([(phase, 1.0)])
        )
        for part, share in inner:
            merged[part] = merged.get(part, 0.0) + weight * share
    if not merged:
        return Isotropic()
    if len(merged) == 1:
        return next(iter(merged))
    top = max(merged.values())
    total = math.fsum(x / top for x in merged.values())
    shares = {p: x / top / total for p, x in merged.items()}
    kept = {p: f for p, f in shares.items() if f > 0.0}
    return PhaseMixture(tuple(kept), tuple(kept.values())) if len(kept) > 1 else next(iter(kept))


def _leading(order: int, *values: float) -> FloatArray:
    moments = np.zeros(checked_order(order) + 1)
    n = min(len(values), order + 1)
    moments[:n] = values[:n]
    return moments
