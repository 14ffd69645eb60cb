"""A phase function given by a table, linear in cos θ between its points."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.phase.base import PhaseFunction, checked_order
from livlab.units import FloatArray


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Tabulated(PhaseFunction):
    """A table p(cos θ), linear between its points, normalised exactly over the sphere.

    The distribution is then a piecewise quadratic, inverted in closed form. Points are kept as
    w = 1 − cos θ, so that a peak narrower than 10⁻⁸ in cos θ can be given by `from_complement`.

    Parameters
    ----------
    cos_theta
        (N,) cosines, strictly increasing or strictly decreasing, from −1 to 1 with both ends.
    pdf
        (N,) values per steradian, ≥ 0 and not all zero; any scale.

    Raises
    ------
    InputError
        If the lengths differ, a value is negative or not finite, the cosines are not monotonic or do not
        span [−1, 1], or everything is zero.

    Examples
    --------
    >>> triangle = Tabulated([-1.0, 1.0], [0.0, 1.0])
    >>> round(triangle.anisotropy, 12)
    0.333333333333
    """

    complement: FloatArray = field()
    """(N,) 1 − cos θ, increasing from 0 to 2."""
    values: FloatArray = field()
    """(N,) values per steradian at those points, normalised."""
    _cumulative: FloatArray = field()
    _digest: bytes = field()

    def __init__(self, cos_theta: Any, pdf: Any) -> None:
        mu = np.array(cos_theta, dtype=np.float64)
        p = np.array(pdf, dtype=np.float64)
        if mu.ndim == 1 and mu.size > 1 and mu[0] < mu[-1]:
            mu, p = mu[::-1], p[::-1]
        self._set(1.0 - mu, p, "cos_theta")

    @classmethod
    def from_complement(cls, complement: Any, pdf: Any) -> Tabulated:
        """The same from w = 1 − cos θ, strictly increasing from 0 to 2, with its values per steradian."""
        made = cls.__new__(cls)
        made._set(np.array(complement, dtype=np.float64), np.array(pdf, dtype=np.float64), "complement")
        return made

    def _set(self, w: FloatArray, p: FloatArray, name: str) -> None:
        what = f"Tabulated.{name}"
        if w.ndim != 1 or w.shape != p.shape or w.size < 2:
            raise InputError.of(
                what, (w.shape, p.shape), "table and pdf must be 1-D, of equal length >= 2", "Give two equal columns."
            )
        ends = (w[0], w[-1])
        if abs(w[0]) <= 1e-12:
            w[0] = 0.0
        if abs(w[-1] - 2.0) <= 1e-12:
            w[-1] = 2.0
        if not np.isfinite(w).all() or not (np.diff(w) > 0).all():
            raise InputError.of(what, w, "must be finite and strictly monotonic", "Sort it and drop repeated points.")
        if w[0] != 0.0 or w[-1] != 2.0:
            raise InputError.of(what, ends, "must span all angles from 0 to 180 degrees", "Extend the table.")
        bad = ~(np.isfinite(p) & (p >= 0.0))
        if bad.any():
            raise InputError.of("Tabulated.pdf", float(p[bad][0]), "must be finite and >= 0", "Mend the table.")
        top = float(p.max())
        if top == 0.0:
            raise InputError.of("Tabulated.pdf", 0.0, "must not be zero everywhere", "Give a phase function.")
        p = p / top
        masses = math.pi * (p[1:] + p[:-1]) * np.diff(w)
        total = math.fsum(masses)
        cumulative = np.concatenate([[0.0], np.cumsum(masses) / total])
        cumulative /= cumulative[-1]
        p = p / total
        for name_, array in (("complement", w), ("values", p), ("_cumulative", cumulative)):
            array.setflags(write=False)
            object.__setattr__(self, name_, array)
        digest = hashlib.blake2b(w.tobytes() + p.tobytes(), digest_size=16).digest()
        object.__setattr__(self, "_digest", digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Tabulated) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    def __repr__(self) -> str:
        return f"Tabulated({self.complement.size} points, g={self.anisotropy:.6g})"

    @property
    def cos_theta(self) -> FloatArray:
        """(N,) the cosines of the table, decreasing from 1 to −1."""
        return 1.0 - self.complement

    @property
    def anisotropy(self) -> float:
        """Mean cosine g, integrated exactly."""
        w, p = self.complement, self.values
        mean = np.diff(w) * (p[:-1] * (2.0 * w[:-1] + w[1:]) + p[1:] * (w[:-1] + 2.0 * w[1:])) / 6.0
        return 1.0 - 2.0 * math.pi * math.fsum(mean)

    def pdf_complement(self, w: FloatArray) -> FloatArray:
        """Value per steradian at cos θ = 1 − w."""
        return np.asarray(np.interp(w, self.complement, self.values))

    def cdf_complement(self, w: FloatArray) -> FloatArray:
        """Probability that 1 − cos θ is at most w."""
        w = np.asarray(w, dtype=np.float64)
        k = np.clip(np.searchsorted(self.complement, w, side="right") - 1, 0, self.complement.size - 2)
        s = w - self.complement[k]
        p0, slope = self.values[k], self._slope(k)
        return np.asarray(np.minimum(self._cumulative[k] + 2.0 * math.pi * s * (p0 + 0.5 * slope * s), 1.0))

    def quantile_complement(self, v: FloatArray) -> FloatArray:
        """The w whose distribution is v: the stable root of each cell's quadratic."""
        v = np.asarray(v, dtype=np.float64)
        k = np.clip(np.searchsorted(self._cumulative, v, side="right") - 1, 0, self.complement.size - 2)
        rest = np.maximum(v - self._cumulative[k], 0.0) / (2.0 * math.pi)
        p0, slope = self.values[k], self._slope(k)
        root = np.sqrt(np.maximum(p0 * p0 + 2.0 * slope * rest, 0.0))
        below = p0 + root
        s = np.divide(2.0 * rest, below, out=np.zeros_like(below), where=below > 0.0)
        return np.asarray(np.minimum(self.complement[k] + s, self.complement[k + 1]))

    def _slope(self, k: Any) -> FloatArray:
        w, p = self.complement, self.values
        return np.asarray((p[k + 1] - p[k]) / (w[k + 1] - w[k]))

    def legendre(self, order: int) -> FloatArray:
        """Moments χ_l = 2π ∫ p P_l dcosθ for l = 0 … order, to about 1e-13.

        Gauss's rule with six points is exact to rounding on a cell with l Δθ ≤ 1; wider cells are divided.
        """
        checked_order(order)
        theta = 2.0 * np.arcsin(np.sqrt(0.5 * self.complement))
        parts = np.maximum(1, np.ceil(np.diff(theta) * (order + 1)).astype(int))
        cell = np.repeat(np.arange(parts.size), parts)
        step = np.arange(cell.size) - np.repeat(np.cumsum(parts) - parts, parts)
        # Equal steps in θ, but never through it back to w at the table's own points.
        t0 = theta[cell] + np.diff(theta)[cell] * step / parts[cell]
        t1 = theta[cell] + np.diff(theta)[cell] * (step + 1) / parts[cell]
        w0 = np.where(step == 0, self.complement[cell], 2.0 * np.sin(0.5 * t0) ** 2)
        w1 = np.where(step + 1 == parts[cell], self.complement[cell + 1], 2.0 * np.sin(0.5 * t1) ** 2)
        node, weight = np.polynomial.legendre.leggauss(6)
        half = 0.5 * (w1 - w0)
        w = (0.5 * (w0 + w1))[:, None] + half[:, None] * node
        p = self.values[cell][:, None] + self._slope(cell)[:, None] * (w - self.complement[cell][:, None])
        mass = (2.0 * math.pi * half[:, None] * weight * p).ravel()
        from livlab.model.tissue.phase.moments import moments

        return np.asarray(moments(w.ravel(), mass, order))
