"""How far the parameters may lie from the optimum by what the residuals, and the forward model's errors, show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from livlab.fitting.problem import Problem
from livlab.optimise import Covariance, covariance_of_residuals
from livlab.units import FloatArray


@dataclass(frozen=True, eq=False)
class ParameterSpread:
    """Second moments of the parameters about an optimum.

    Attributes
    ----------
    covariance
        Of the residuals and the forward model's errors.
    plain
        Of the residuals alone.
    variance
        Of one residual.
    autocorrelation
        Of neighbouring residuals.
    """

    covariance: Covariance
    plain: Covariance
    variance: float
    autocorrelation: float

    @classmethod
    def of(cls, problem: Problem, at: Mapping[str, float], widened: float = 1.0) -> Self:
        """At an optimum of the problem; the variance of a residual `widened` times what it would be."""
        variance, autocorrelation = residual_variance(problem, at)
        variance *= widened
        slopes = problem.jacobian(at)
        plain = covariance_of_residuals(slopes, problem.space, at, variance=variance)
        scatter = _scatter(problem, slopes, at, variance)
        if scatter is None:
            return cls(plain, plain, variance, autocorrelation)
        whole = covariance_of_residuals(slopes, problem.space, at, variance=variance, scatter=scatter)
        return cls(whole, plain, variance, autocorrelation)

    def rises(self, wanted: float) -> dict[str, float]:
        """Rise of Σ r² at an interval's end by parameter, `wanted` by the residuals alone.

        More where the forward model's errors widen what residuals alone would say.
        """
        whole, plain = self.covariance, self.plain
        ratios = {n: (whole.sd[n] / plain.sd[n]) ** 2 for n in plain.matrix.index if 0 < plain.sd[n] < math.inf}
        most = max([1.0, *(r for r in ratios.values() if math.isfinite(r))])
        return {name: wanted * max(1.0, min(ratios.get(name, most), most)) for name in plain.space.names}


def residual_variance(problem: Problem, at: Mapping[str, float]) -> tuple[float, float]:
    """Variance of one residual, and the neighbours' correlation of the residuals.

    With every σ known it is 1. Else the residuals show their own size, which is not below rounding's. Where neighbours
    are alike, only n_e = n (1 − ρ)/(1 + ρ) of n count (Bartlett 1935, first order): Σ r²/n · n_e/(n_e − p) each, and
    n/n_e times that for what they say together.
    """
    r = problem.residuals(at)
    free = len(problem.space.free)
    if not problem.by_residuals:
        return 1.0, _neighbours(r)
    correlation = _neighbours(r)
    held = max(correlation, 0.0)
    count = max(len(r) * (1.0 - held) / (1.0 + held), free + 1.0)
    return max(float(r @ r) / max(count - free, 1.0), problem.least_variance(at)), correlation


def _scatter(
    problem: Problem, slopes: Mapping[str, FloatArray], at: Mapping[str, float], variance: float
) -> dict[tuple[str, str], float] | None:
    """Covariance of Jᵀr by pairs of names, None if the forward model has no errors beyond what the residuals weigh in.

    To the residuals' own it adds that of the forward model, whose errors hang together along the curve and so move the
    parameters more than independent ones.
    """
    shaken = problem.shaken(at)
    if not shaken.any():
        return None
    total = {name: np.array(slopes[name]) for name in problem.space.names}
    for p in problem.space.parameters:
        if p.tied in total and p.name in slopes:
            total[p.tied] = total[p.tied] + p.factor * slopes[p.name]
    made = {}
    for a, left in total.items():
        for b, right in total.items():
            made[a, b] = float(variance * (left @ right) + (left @ shaken) @ (right @ shaken))
        sd = problem.space.by_name[a].prior_sd
        made[a, a] += variance / sd**2 if sd is not None else 0.0
    return made


def _neighbours(r: FloatArray) -> float:
    if len(r) < 3 or not float(r @ r) > 0:
        return 0.0
    return float(np.clip(np.sum(r[1:] * r[:-1]) / np.sum(r * r), -0.99, 0.99))
