"""Profile-likelihood intervals of a fit at the price of a few evaluations an end, bounds of the others respected.

A normal interval takes the parameters at a bound as known, and the valley of χ² as straight: both make it too narrow
where parameters trade against one another. A profile follows the valley. Each end is sought by Gauss–Newton: at a point
the residuals are taken as linear, the bounded least-squares problem gives the end where χ² has risen enough, there the
residuals are taken anew (the scheme of Venzon & Moolgavkar 1988, with bounds).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from livlab.errors import LivlabError
from livlab.fitting.problem import Problem
from livlab.optimise import ParameterSpace
from livlab.units import FloatArray

STEPS = 24
"""Points of linearisation an end, at most."""

REGION = 0.3
"""Share of the box within which residuals are taken as linear."""

TOO_HIGH = 1.0
"""Share of the wanted rise by which it may be missed; beyond, or if nothing was gained, a step is taken back."""

CLOSE = 0.05
"""Share of the wanted rise within which an end is accepted: 2.5 % of a half-width."""


@dataclass(frozen=True)
class ProfileInterval:
    """An interval in the parameter's unit; an open side ends at its bound, a rough one was not reached in time."""

    lower: float
    upper: float
    open_below: bool
    open_above: bool
    rough: bool

    @property
    def spans(self) -> bool:
        """Whether it says nothing: it reaches from bound to bound."""
        return self.open_below and self.open_above


@dataclass
class Profiler:
    """Intervals of all free parameters about an optimum.

    Attributes
    ----------
    problem, space, best
        Residuals, the parameters, and where the least was found.
    unit
        Variance of one residual: χ² is Σ r² over it, and a prior counts that much in Σ r².
    ends
        Points where the ends were found.
    lost
        Points that the forward model could not answer for: a recording that is to hold the intervals must serve them.
    """

    problem: Problem
    space: ParameterSpace
    best: Mapping[str, float]
    unit: float = 1.0
    ends: list[dict[str, float]] = field(default_factory=list)
    lost: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.x = self.space.vector(self.best)
        r, _ = self._point(self.x)
        self.base = float(r @ r)

    def interval(self, name: str, rise: float) -> ProfileInterval:
        """Where Σ r², minimised over the other parameters, is `rise` above its least.

        Parameters
        ----------
        name
            A free parameter.
        rise
            z² times the variance of one residual.
        """
        k = self.space.names.index(name)
        (low, below, a), (high, above, b) = (self._end(k, sign, rise) for sign in (-1.0, 1.0))
        p = self.space.by_name[name]
        return ProfileInterval(
            p.low if below else self._value(k, low), p.high if above else self._value(k, high), below, above, a or b
        )

    def _value(self, k: int, at: float) -> float:
        moved = self.x.copy()
        moved[k] = at
        return self.space.values(moved)[self.space.names[k]]

    def _point(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N + P,) residuals with the priors' and their (N + P, F) derivatives by x; nan where there is no answer."""
        values = self.space.values(x)
        try:
            r = self.problem.residuals(values)
            slopes = self.problem.jacobian(values)
        except LivlabError:
            return np.full(1, np.nan), np.zeros((1, len(x)))
        by_x = self.space.slopes(x)
        columns = []
        for k, name in enumerate(self.space.names):
            total = np.array(slopes[name])
            for p in self.space.parameters:
                if p.tied == name and p.name in slopes:
                    total = total + p.factor * slopes[p.name]
            columns.append(total * by_x[k])
        rows, extra = [], []
        for k, p in enumerate(self.space.free):
            if p.prior_mean is not None and p.prior_sd is not None:
                rows.append(math.sqrt(self.unit) * (values[p.name] - p.prior_mean) / p.prior_sd)
                extra.append(np.eye(len(x))[k] * by_x[k] * math.sqrt(self.unit) / p.prior_sd)
        jacobian = np.array(columns).T
        if not rows:
            return r, jacobian
        return np.concatenate([r, rows]), np.concatenate([jacobian, np.array(extra)])

    def _end(self, k: int, sign: float, rise: float) -> tuple[float, bool, bool]:
        """(where, whether the bound is reached, whether it is rough), in x."""
        edge = float(self.space.high[k] if sign > 0 else self.space.low[k])
        if edge == self.x[k]:
            return edge, True, False
        there, reached, rough = self._walk(k, sign, rise, edge)
        self.ends.append(self.space.values(there))
        return float(there[k]), reached, rough

    def _walk(self, k: int, sign: float, rise: float, edge: float) -> tuple[FloatArray, bool, bool]:
        here = self.x.copy()
        r, jacobian = self._point(here)
        inner, outer, region = self.x[k], edge, REGION
        for _ in range(STEPS):
            there = self._linear(k, here, r, jacobian, rise, inner, outer, region)
            found, slopes = self._point(there)
            while not np.isfinite(found).all():
                self.lost.append(self.space.values(there))
                outer, region = there[k], 0.5 * region
                there = 0.5 * (there + here)
                if region < 1e-3 * REGION:
                    return here, False, True
                found, slopes = self._point(there)
            risen = float(found @ found) - self.base
            # Linear residuals promise the wanted rise: what they miss by says how far they can be believed.
            old, new = (max((x - self.base) / rise - 1.0, 0.0) for x in (float(r @ r), risen + self.base))
            if new > CLOSE and new >= (min(old, TOO_HIGH) if old > CLOSE else TOO_HIGH) and region > 0.01 * REGION:
                region *= 0.4
                continue
            free = float(np.abs(there - here).max()) < 0.9 * region
            region = max(0.5 * region, 0.01 * REGION) if new > max(0.5 * old, CLOSE) else min(1.5 * region, REGION)
            moved = abs(float(there[k] - here[k]))
            here, r, jacobian = there, found, slopes
            if risen <= rise:
                # What a point allows, the profile allows: the end lies beyond it.
                inner = sign * max(sign * inner, sign * float(there[k]))
                if there[k] == edge:
                    return there, True, False
            near = abs(risen - rise) <= CLOSE * rise
            if near and free and moved <= CLOSE * abs(float(there[k] - self.x[k])) + 1e-6:
                return there, False, False
        return here, False, True

    def _linear(
        self,
        k: int,
        here: FloatArray,
        r: FloatArray,
        jacobian: FloatArray,
        rise: float,
        inner: float,
        outer: float,
        region: float,
    ) -> FloatArray:
        """The farthest point on the way from `inner` to `outer` at which linear residuals stay below the rise."""
        from scipy.optimize import brentq, lsq_linear

        others = [j for j in range(len(here)) if j != k]
        ridge = 1e-6 * float(np.linalg.norm(jacobian)) * np.eye(len(others))
        matrix = np.concatenate([jacobian[:, others], ridge])
        low = np.maximum(self.space.low, here - region)[others]
        high = np.minimum(self.space.high, here + region)[others]
        high = np.maximum(high, low + 1e-12)
        points: dict[float, FloatArray] = {}

        def above(t: float) -> float:
            point = here.copy()
            point[k] = t
            if others:
                wanted = -(r + jacobian[:, k] * (t - here[k]))
                step = lsq_linear(
                    matrix,
                    np.concatenate([wanted, np.zeros(len(others))]),
                    (low - here[others], high - here[others]),
                    method="bvls",
                ).x
                point[others] = np.clip(here[others] + step, self.space.low[others], self.space.high[others])
            points[t] = point
            left = r + jacobian @ (point - here)
            return float(left @ left) - self.base - rise

        sign = math.copysign(1.0, outer - self.x[k]) if outer != self.x[k] else 1.0
        far = sign * min(sign * outer, sign * float(here[k]) + region)
        near = sign * max(sign * inner, sign * float(here[k]) - region)
        if sign * far <= sign * near:
            far = outer
        if above(far) <= 0.0:
            return points[far]
        if above(near) >= 0.0:
            # The valley's floor first, then along it.
            gain = float(r @ r) - self.base - rise - above(float(here[k]))
            return points[float(here[k])] if gain > CLOSE * rise else points[near]
        t = float(brentq(above, near, far, xtol=1e-4 * abs(far - near), rtol=1e-6))
        above(t)
        return points[t]


__all__ = ["ProfileInterval", "Profiler"]
