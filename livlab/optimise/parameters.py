"""Parameters of a fit: bounds, transforms, what is fixed or tied, and what is known beforehand."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from livlab.errors import InputError
from livlab.units import FloatArray

Transform = Literal["linear", "log", "logit"]
"""How the optimiser sees a parameter: as it is, as its logarithm, or as the log-odds of its place between bounds."""

LOGIT_EDGE = 1e-6
"""Share of the range next to each bound that a logit parameter cannot enter, so that its box stays finite."""

AT_BOUND = 1e-6
"""A parameter within this share of its box from a bound counts as lying on it."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a fit, in its own unit.

    Parameters
    ----------
    name
        Its name in the mapping that the objective receives.
    low, high
        Bounds; infinite ones are allowed where the algorithm is local. A `log` parameter needs low >= 0.
    start
        First guess; the middle of the (transformed) bounds if not given.
    transform
        `linear`, `log` (scale parameters: equal ratios are equal steps) or `logit` (shares between two bounds).
    fixed
        Keep it at `start`.
    tied, factor
        Follow another parameter: value = factor × that parameter.
    prior_mean, prior_sd
        Gaussian knowledge from elsewhere, in the parameter's unit; adds ½ ((p − mean)/sd)² to a negative
        log-likelihood (scaled to the objective's own one-sigma rise, see `minimise`).

    Raises
    ------
    InputError
        Bounds in the wrong order or not numbers, a start outside them, a transform they do not allow.

    Examples
    --------
    >>> Parameter("alpha", 0.01, 1.0, transform="log").start_value
    0.1
    """

    name: str
    low: float = -math.inf
    high: float = math.inf
    start: float | None = None
    transform: Transform = "linear"
    fixed: bool = False
    tied: str | None = None
    factor: float = 1.0
    prior_mean: float | None = None
    prior_sd: float | None = None

    def __post_init__(self) -> None:
        field = f"parameter {self.name}"
        if math.isnan(self.low) or math.isnan(self.high) or not self.low <= self.high:
            raise InputError.of(field, (self.low, self.high), "low must not exceed high", "Swap or correct the bounds.")
        if self.transform not in ("linear", "log", "logit"):
            raise InputError.of(field, self.transform, "must be linear, log or logit", "Name one of the three.")
        if self.transform == "log" and self.low < 0:
            raise InputError.of(field, self.low, "a log parameter cannot be negative", "Use low >= 0, or linear.")
        if self.transform == "logit" and not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise InputError.of(field, (self.low, self.high), "a logit parameter needs two finite bounds", "Give both.")
        if self.start is not None and not (math.isfinite(self.start) and self.low <= self.start <= self.high):
            bound = f"start must lie within [{self.low:g}, {self.high:g}]"
            raise InputError.of(field, self.start, bound, "Move the start or widen the bounds.")
        if self.transform == "log" and self.start == 0:
            raise InputError.of(field, 0, "a log parameter cannot start at 0", "Start above 0.")
        if (self.prior_mean is None) != (self.prior_sd is None) or (
            self.prior_sd is not None and not self.prior_sd > 0
        ):
            given = (self.prior_mean, self.prior_sd)
            raise InputError.of(field, given, "a prior needs a mean and a standard deviation > 0", "Give both.")
        if self.fixed and self.start is None:
            raise InputError.of(field, None, "a fixed parameter needs its value", "Give it as start.")
        if self.tied is not None and self.fixed:
            raise InputError.of(field, self.tied, "is both fixed and tied", "Choose one.")

    @property
    def start_value(self) -> float:
        """The start, or the middle of the transformed bounds, or the nearest number to 1 (log) or 0 within them."""
        if self.start is not None:
            return float(self.start)
        if self.transform == "log":
            if self.low > 0 and math.isfinite(self.high):
                return math.sqrt(self.low * self.high)
            return min(1.0, self.high) if self.low < 1.0 else 2.0 * self.low
        if math.isfinite(self.low) and math.isfinite(self.high):
            return 0.5 * (self.low + self.high)
        return min(max(0.0, self.low), self.high)

    def inward(self, value: float) -> float:
        """The parameter's transformed value t: p, ln p, or ln((p − low)/(high − p))."""
        if self.transform == "log":
            return math.log(value) if value > 0 else -math.inf
        if self.transform == "logit":
            share = (value - self.low) / (self.high - self.low) if self.high > self.low else 0.5
            share = min(max(share, LOGIT_EDGE), 1.0 - LOGIT_EDGE)
            return math.log(share / (1.0 - share))
        return value

    def outward(self, transformed: float) -> float:
        """The value that belongs to a transformed one, kept within the bounds whatever the rounding."""
        if self.transform == "log":
            value = math.exp(min(transformed, 709.0))
        elif self.transform == "logit":
            value = self.low + (self.high - self.low) / (1.0 + math.exp(-transformed))
        else:
            value = transformed
        return min(max(value, self.low), self.high)

    def slope(self, value: float) -> float:
        """Derivative dp/dt of the value with its transformed value."""
        if self.transform == "log":
            return value
        if self.transform == "logit":
            return (value - self.low) * (self.high - value) / (self.high - self.low)
        return 1.0


class ParameterSpace:
    """The free parameters as one vector x, each in units of its box, t_high − t_low.

    A linear parameter is measured from 0, so that a small one keeps all its digits; a logarithm or log-odds from its
    lower bound, or from its start if that is infinite. Without two finite transformed bounds the unit is max(|t|, 1) of
    a linear one's start and 1 of a logarithm.

    Parameters
    ----------
    parameters
        Names must be different; a tie must lead to a parameter that is not itself tied.

    Raises
    ------
    InputError
        Names twice, ties to nothing or in chains.
    """

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self.parameters = tuple(parameters)
        by_name = {p.name: p for p in self.parameters}
        if len(by_name) != len(self.parameters):
            names = [p.name for p in self.parameters]
            raise InputError.of("parameters", names, "names must differ", "Rename the doubles.")
        for p in self.parameters:
            if p.tied is not None and (p.tied not in by_name or by_name[p.tied].tied is not None):
                bound = "must be tied to another parameter that is not tied itself"
                raise InputError.of(f"parameter {p.name}", p.tied, bound, f"Choose from {sorted(by_name)}.")
        self.by_name = by_name
        # Bounds that coincide leave nothing to fit.
        self.free = tuple(p for p in self.parameters if not p.fixed and p.tied is None and p.low < p.high)
        self.names = tuple(p.name for p in self.free)
        ends = [(p.inward(p.low), p.inward(p.high), p.inward(p.start_value)) for p in self.free]
        boxed = [math.isfinite(low) and math.isfinite(high) for low, high, _ in ends]
        self.origin = np.array(
            [
                0.0 if p.transform == "linear" else low if box else s
                for p, (low, _, s), box in zip(self.free, ends, boxed, strict=True)
            ]
        )
        self.unit = np.array(
            [
                high - low if box else max(abs(s), 1.0) if p.transform == "linear" else 1.0
                for p, (low, high, s), box in zip(self.free, ends, boxed, strict=True)
            ]
        )
        low, high, start = np.array(ends).reshape(-1, 3).T
        self.low = (low - self.origin) / self.unit
        self.high = (high - self.origin) / self.unit
        self.start = (start - self.origin) / self.unit

    def rescaled(self, factors: FloatArray) -> ParameterSpace:
        """The same parameters with x measured in other units: x_new = x / factor."""
        other = copy.copy(self)
        other.unit = self.unit * factors
        other.low, other.high, other.start = self.low / factors, self.high / factors, self.start / factors
        return other

    def values(self, x: FloatArray) -> dict[str, float]:
        """All parameters, also fixed and tied ones, at the vector x."""
        t = self.origin + self.unit * x
        found = {p.name: p.outward(float(ti)) for p, ti in zip(self.free, t, strict=True)}
        for k, p in enumerate(self.free):
            if p.transform != "logit" and not self.low[k] < x[k] < self.high[k]:
                found[p.name] = float(p.low if x[k] <= self.low[k] else p.high)  # whatever the rounding
        for p in self.parameters:
            if p.tied is None and p.name not in found:
                found[p.name] = p.start_value
        for p in self.parameters:
            if p.tied is not None:
                found[p.name] = p.factor * found[p.tied]
        return {p.name: found[p.name] for p in self.parameters}

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """The vector x of given values, moved inside the box.

        Raises
        ------
        InputError
            A free parameter without a finite value.
        """
        x = np.empty(len(self.free))
        for k, p in enumerate(self.free):
            value = float(values.get(p.name, p.start_value))
            if not math.isfinite(value):
                raise InputError.of(f"parameter {p.name}", value, "must be finite", "Give a number.")
            x[k] = (p.inward(min(max(value, p.low), p.high)) - self.origin[k]) / self.unit[k]
            x[k] = self.low[k] if value <= p.low else self.high[k] if value >= p.high else x[k]
        return np.clip(x, self.low, self.high)

    def slopes(self, x: FloatArray) -> FloatArray:
        """dp/dx of the free parameters."""
        values = self.values(x)
        return np.array([p.slope(values[p.name]) * u for p, u in zip(self.free, self.unit, strict=True)])

    def sizes(self, x: FloatArray) -> FloatArray:
        """(n,) how large each parameter is in x: a linear one's number (or 1 of x), a log or logit one's unit step."""
        t = self.origin + self.unit * x
        linear = np.array([p.transform == "linear" for p in self.free], dtype=bool)
        return np.where(linear, np.where(t != 0.0, np.abs(t) / self.unit, 1.0), 1.0 / self.unit)

    def elsewhere(self, x: FloatArray, k: int) -> list[FloatArray]:
        """Points with parameter k far from where it is: at its start, at the ends and the middle of its box.

        Of an infinite box: at shares of its size, and at its opposite.
        """
        low, high = float(self.low[k]), float(self.high[k])
        ends = [v for v in (low, high, 0.5 * (low + high)) if math.isfinite(v)]
        size = float(self.sizes(x)[k])
        shares = [] if len(ends) == 3 else [x[k] - share * size for share in (0.9, 0.999, 2.0, -9.0)]
        found = []
        for value in (float(self.start[k]), *ends, *shares):
            moved = x.copy()
            moved[k] = min(max(value, low), high)
            if abs(moved[k] - x[k]) > 1e-6 * size:
                found.append(moved)
        return found

    def columns(self, x: FloatArray, natural: Mapping[str, FloatArray]) -> FloatArray:
        """(m, n) derivatives of m numbers by x, from those by every parameter, ties included by the chain rule."""
        columns = []
        none = np.zeros(next((np.size(column) for column in natural.values()), 0))
        for name, slope in zip(self.names, self.slopes(x), strict=True):
            total = np.array(natural.get(name, none), dtype=np.float64).ravel()
            for p in self.parameters:
                if p.tied == name and p.name in natural:
                    total = total + p.factor * np.ravel(natural[p.name])
            columns.append(total * slope)
        return np.array(columns).T

    def gradient(self, x: FloatArray, natural: Mapping[str, float]) -> FloatArray:
        """Gradient with x from derivatives by every parameter, ties included by the chain rule."""
        total = {p.name: float(natural.get(p.name, 0.0)) for p in self.parameters}
        for p in self.parameters:
            if p.tied is not None:
                total[p.tied] += p.factor * float(natural.get(p.name, 0.0))
        return np.array([total[name] for name in self.names]) * self.slopes(x)

    def prior(self, values: Mapping[str, float]) -> float:
        """½ Σ ((p − mean)/sd)² over the parameters with a prior."""
        return 0.5 * sum(
            ((values[p.name] - p.prior_mean) / p.prior_sd) ** 2
            for p in self.parameters
            if p.prior_mean is not None and p.prior_sd is not None
        )

    def prior_residuals(self, x: FloatArray, scale: float) -> FloatArray:
        """(P,) residuals whose ½ Σ r² is scale × `prior`, of the parameters with a prior."""
        values = self.values(x)
        known = [(p, p.prior_mean, p.prior_sd) for p in self.parameters]
        found = [(values[p.name] - mean) / sd for p, mean, sd in known if mean is not None and sd is not None]
        return math.sqrt(scale) * np.array(found, dtype=np.float64)

    def prior_columns(self, x: FloatArray, scale: float) -> FloatArray:
        """(P, n) their derivatives by x."""
        rows = []
        for p in self.parameters:
            if p.prior_sd is not None:
                along = {q.name: np.array([1.0 if q.name == p.name else 0.0]) for q in self.parameters}
                rows.append(self.columns(x, along)[0] * math.sqrt(scale) / p.prior_sd)
        return np.array(rows).reshape(-1, x.size)

    def prior_gradient(self, values: Mapping[str, float]) -> dict[str, float]:
        """Derivatives of `prior` by each parameter's value."""
        return {
            p.name: (values[p.name] - p.prior_mean) / p.prior_sd**2
            for p in self.parameters
            if p.prior_mean is not None and p.prior_sd is not None
        }

    def status(self, x: FloatArray, start: FloatArray, *, exact: bool = False) -> dict[str, str]:
        """Of each parameter: fixed, tied, at a bound, unchanged from the start, or free.

        Parameters
        ----------
        x, start
            Where it ended and began.
        exact
            Only what lies on a bound is at it, since the objective was seen to tell it from the bound otherwise.
        """
        found: dict[str, str] = {}
        width, sizes = np.where(np.isfinite(self.high - self.low), self.high - self.low, 1.0), self.sizes(x)
        for p in self.parameters:
            if p.tied is not None:
                found[p.name] = f"tied to {p.tied}"
            elif p.name not in self.names:
                found[p.name] = "fixed"
        for k, name in enumerate(self.names):
            near = 0.0 if exact else AT_BOUND * width[k]
            if x[k] - self.low[k] <= near:
                found[name] = "at lower bound"
            elif self.high[k] - x[k] <= near:
                found[name] = "at upper bound"
            else:
                still = 1e-9 * min(float(width[k]), float(sizes[k])) if exact else 1e-9 * width[k]
                found[name] = "unchanged from start" if abs(x[k] - start[k]) <= still else "free"
        return {p.name: found[p.name] for p in self.parameters}

    def finite_box(self) -> list[str]:
        """Names of the free parameters that lack a finite box."""
        finite = np.isfinite(self.low) & np.isfinite(self.high)
        return [name for name, good in zip(self.names, finite, strict=True) if not good]
