"""What every phase function shares: it lives on the complement w = 1 − cos θ.

A forward peak of width 10⁻³ rad ends at w = 5·10⁻⁷; in cos θ that leaves nine digits, in w all sixteen.
The classes therefore state density, distribution and quantile in w, and `pdf`, `cdf`, `sample` follow.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol, runtime_checkable

import numpy as np

from livlab.errors import InputError
from livlab.units import FloatArray


@runtime_checkable
class Phase(Protocol):
    """A phase function of the scattering angle alone, normalised to 1 over the sphere."""

    @property
    def anisotropy(self) -> float:
        """Mean cosine g of the scattering angle."""
        ...

    def pdf(self, cos_theta: FloatArray) -> FloatArray:
        """Value per steradian at the given cosines: 2π ∫ p dcosθ = 1."""
        ...

    def cdf(self, cos_theta: FloatArray) -> FloatArray:
        """Probability that the cosine is at most the given one."""
        ...

    def sample(self, u: FloatArray) -> FloatArray:
        """Cosines whose cdf is u, for u in [0, 1)."""
        ...

    def legendre(self, order: int) -> FloatArray:
        """Moments χ_l = 2π ∫ p P_l dcosθ for l = 0 … order; χ_0 = 1, χ_1 = g."""
        ...


class PhaseFunction(ABC):
    """A phase function of the scattering angle, normalised to 1 over the sphere.

    Subclasses give `anisotropy`, `legendre` and the three functions of the complement w = 1 − cos θ in
    [0, 2]; they satisfy `Phase`.
    """

    @property
    @abstractmethod
    def anisotropy(self) -> float:
        """Mean cosine g of the scattering angle."""

    @abstractmethod
    def pdf_complement(self, w: FloatArray) -> FloatArray:
        """Value per steradian at cos θ = 1 − w: 2π ∫₀² p dw = 1."""

    @abstractmethod
    def cdf_complement(self, w: FloatArray) -> FloatArray:
        """Probability that 1 − cos θ is at most w."""

    @abstractmethod
    def quantile_complement(self, v: FloatArray) -> FloatArray:
        """The w whose `cdf_complement` is v, for v in [0, 1]."""

    @abstractmethod
    def legendre(self, order: int) -> FloatArray:
        """Moments χ_l = 2π ∫ p P_l dcosθ for l = 0 … order; χ_0 = 1, χ_1 = g."""

    def pdf(self, cos_theta: FloatArray) -> FloatArray:
        """Value per steradian at the given cosines: 2π ∫ p dcosθ = 1.

        Raises
        ------
        InputError
            If a cosine lies outside [−1, 1].
        """
        return self.pdf_complement(1.0 - within("cos_theta", cos_theta, -1.0, 1.0))

    def cdf(self, cos_theta: FloatArray) -> FloatArray:
        """Probability that the cosine is at most the given one.

        Raises
        ------
        InputError
            If a cosine lies outside [−1, 1].
        """
        return 1.0 - self.cdf_complement(1.0 - within("cos_theta", cos_theta, -1.0, 1.0))

    def sample(self, u: FloatArray) -> FloatArray:
        """Cosines whose cdf is u, for u in [0, 1).

        Raises
        ------
        InputError
            If u lies outside [0, 1].
        """
        return 1.0 - self.quantile_complement(1.0 - within("u", u, 0.0, 1.0))


def within(field: str, values: Any, low: float, high: float) -> FloatArray:
    """The values as a float array, or an `InputError` naming the first outside [low, high] (NaN included)."""
    array = np.asarray(values, dtype=np.float64)
    good = (array >= low) & (array <= high)
    if not good.all():
        raise InputError.of(
            field, float(array[~good].flat[0]), f"must be within [{low:g}, {high:g}]", "Mend the value."
        )
    return array


def checked_order(order: int) -> int:
    """The order of a Legendre expansion, or an `InputError` if negative."""
    if order < 0:
        raise InputError.of("order", order, "must be >= 0", "Ask for order 0 or more.")
    return order
