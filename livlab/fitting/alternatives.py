"""Several models of one measurement: how well each explains it, and how far their answers lie apart.

An interval of one fit holds what noise can do if the model is right. What another model that explains the data as well
would have said is no part of it; here it is, weighed by Akaike's or Schwarz's criterion (Burnham & Anderson 2002).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from livlab.fitting.outcome import FitOutcome
from livlab.fitting.targets import CurveTarget
from livlab.optimise.covariance import normal_quantile
from livlab.optimise.structure import LIMIT
from livlab.units import FloatArray

Criterion = Literal["aic", "bic"]


@dataclass(frozen=True)
class ModelFit:
    """A model that was fitted: what its weight rests on.

    Attributes
    ----------
    loss
        Σ r² at the optimum.
    numbers
        Independent numbers compared, priors among them.
    free
        Free parameters.
    autocorrelation
        Of neighbouring residuals.
    known
        Whether Σ r² is a χ², every σ being known; else the residuals show their own size.
    likely
        Whether Σ r² follows from a likelihood at all: a colour difference does not.
    """

    loss: float
    numbers: int
    free: int
    autocorrelation: float = 0.0
    known: bool = True
    likely: bool = True

    @classmethod
    def of(cls, found: FitOutcome, targets: Sequence[CurveTarget]) -> ModelFit:
        """From a finished fit and what it was fitted to."""
        priors = sum(p.prior_sd is not None for p in found.space.parameters)
        return cls(
            found.loss,
            sum(t.independent for t in targets) + priors,
            len(found.space.free),
            found.autocorrelation,
            all(t.loss == "chi2" for t in targets),
            all(t.loss != "colour" for t in targets),
        )

    @property
    def dof(self) -> int:
        """Numbers left over."""
        return self.numbers - self.free

    @property
    def p(self) -> float:
        """Chance of a larger χ² if the model is right; nan where no σ is known or nothing is left over."""
        from scipy.special import gammaincc

        return float(gammaincc(0.5 * self.dof, 0.5 * self.loss)) if self.known and self.dof > 0 else math.nan


@dataclass(frozen=True, eq=False)
class Weights:
    """Criteria and weights of several models, in their order.

    Attributes
    ----------
    aic, bic
        Akaike's and Schwarz's criterion; nan without a likelihood.
    by_aic, by_bic
        Weights that sum to 1, exp(−Δ/2) over their sum; nan without a likelihood.
    numbers
        Independent numbers that count.
    inflation
        What χ² is divided by, since no model fits within the noise; 1 where one does.
    """

    aic: FloatArray
    bic: FloatArray
    by_aic: FloatArray
    by_bic: FloatArray
    numbers: float
    inflation: float

    def by(self, criterion: Criterion) -> FloatArray:
        """The weights by a criterion."""
        return self.by_aic if criterion == "aic" else self.by_bic


def weigh(models: Sequence[ModelFit]) -> Weights:
    """Akaike's criterion χ² + 2 k and Schwarz's χ² + k ln n of each model, and weights (Burnham & Anderson 2002, 2.9).

    Where every σ is known and the best model fits, χ² counts as it is. Where none does (p < 10⁻³) χ² is divided by that
    of the best over what is left of n_e = n (1 − ρ)/(1 + ρ) numbers, ρ being its neighbours' correlation: the models'
    common misfit is an error, too, and its points hang together (QAIC; ibid., 2.5). Where σ is not known, χ² is
    n_e ln(Σ r²/n) and its size one more parameter. ρ is that of the best model for all of them: else a model would gain
    by leaving a pattern.
    """
    loss = np.array([m.loss for m in models])
    free = np.array([m.free for m in models], dtype=np.float64)
    best = models[int(np.argmin(loss))]
    n = float(best.numbers)
    rho = max(best.autocorrelation, 0.0)
    effective = max(n * (1.0 - rho) / (1.0 + rho), float(free.max()) + 1.0)
    inflation = 1.0
    if not all(m.likely for m in models):
        nothing = np.full(len(models), math.nan)
        return Weights(nothing, nothing, nothing, nothing, n, 1.0)
    if all(m.known for m in models):
        if best.p < LIMIT:
            n, inflation = effective, max(1.0, best.loss / max(effective - best.free, 1.0))
        deviance, count = loss / inflation, free
    else:
        deviance, count = effective * np.log(np.maximum(loss, 1e-300) / n), free + 1.0
        n = effective
    aic, bic = deviance + 2.0 * count, deviance + count * math.log(n)
    return Weights(aic, bic, _shares(aic), _shares(bic), n, inflation)


def _shares(criterion: FloatArray) -> FloatArray:
    """Weights that sum to 1.

    >>> _shares(np.array([10.0, 10.0, 20.0])).round(4).tolist()
    [0.4983, 0.4983, 0.0034]
    """
    relative = np.exp(-0.5 * (criterion - criterion.min()))
    return np.asarray(relative / relative.sum())


@dataclass(frozen=True)
class ModelSays:
    """What one model says of a parameter: its value and interval."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class ModelSpread:
    """How far several models' answers for a parameter lie apart.

    Attributes
    ----------
    value, lower, upper
        Weighted mean, and the interval of the weighted mixture of what the models say.
    between
        Standard deviation of the values between the models, weighted.
    least, most
        Of the values, over all models.
    models
        How many have it.
    """

    value: float
    lower: float
    upper: float
    between: float
    least: float
    most: float
    models: int


def spread(said: Sequence[ModelSays], weights: Sequence[float], level: float) -> ModelSpread:
    """The spread of a parameter over models.

    Each model's answer counts as a normal distribution in two halves, about its value and as wide as its interval; the
    interval is between the outer quantiles of their mixture. Without weights all count alike.

    Parameters
    ----------
    said
        What each model that has the parameter says of it.
    weights
        Of these models; they need not sum to 1.
    level
        Coverage of the intervals.

    Examples
    --------
    >>> found = spread([ModelSays(1.0, 0.8, 1.2), ModelSays(2.0, 1.8, 2.2)], [0.5, 0.5], 0.95)
    >>> round(found.value, 3), round(found.lower, 2), round(found.upper, 2), found.least, found.most
    (1.5, 0.83, 2.17, 1.0, 2.0)
    """
    value = np.array([s.value for s in said])
    share = np.array(weights, dtype=np.float64)
    if not np.isfinite(share).all() or share.sum() <= 0.0:
        share = np.ones(len(said))
    share = share / share.sum()
    mean = float(share @ value)
    tail = 0.5 * (1.0 - level)
    return ModelSpread(
        mean,
        _quantile(said, share, tail, level),
        _quantile(said, share, 1.0 - tail, level),
        math.sqrt(float(share @ (value - mean) ** 2)),
        float(value.min()),
        float(value.max()),
        len(said),
    )


def _quantile(said: Sequence[ModelSays], share: FloatArray, at: float, level: float) -> float:
    """Quantile of the mixture; nan if a model that counts says no interval."""
    from scipy.special import ndtr

    if not all(math.isfinite(s.lower) and math.isfinite(s.upper) for s in said):
        return math.nan
    z = normal_quantile(level)
    low, high = min(s.lower for s in said), max(s.upper for s in said)

    def below(x: float) -> float:
        total = 0.0
        for s, w in zip(said, share, strict=True):
            width = (s.value - s.lower if x < s.value else s.upper - s.value) / z
            total += w * (float(ndtr((x - s.value) / width)) if width > 0 else float(x >= s.value))
        return total

    # The mixture's quantile lies within the outermost intervals, which are that far out in each model alone.
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) < at else (low, middle)
    return 0.5 * (low + high)


def in_words(names: Sequence[str], models: Sequence[ModelFit], weights: Weights, criterion: Criterion) -> list[str]:
    """Sentences on which model the data prefer, the first being the one whose values stand above.

    Parameters
    ----------
    names, models
        Of all, the first being the one that was asked for.
    weights, criterion
        As weighed, and by what.
    """
    share = weights.by(criterion)
    if not np.isfinite(share).all():
        return [
            "A colour gives no likelihood, so that the alternatives have no weights: their spread counts all alike."
        ]
    made = []
    best = int(np.argmax(share))
    if best and share[best] > 2.0 * share[0]:
        made.append(
            f"The data prefer the model “{names[best]}” (weight {share[best]:.2g} by {criterion.upper()}) to the one "
            f"whose values stand first, “{names[0]}” ({share[0]:.2g}): see the alternatives."
        )
    if weights.inflation > 1.0:
        made.append(
            f"None of the {len(models)} models fits the data within their noise (the best has χ² "
            f"{min(m.loss for m in models):.3g} for {models[0].numbers} numbers): what they have in common may be "
            f"wrong. For the weights χ² is divided by {weights.inflation:.3g}."
        )
    return made


def beyond(name: str, own: Mapping[str, float], found: ModelSpread) -> str:
    """A sentence where the models lie further apart than the first one's interval says; empty where they do not."""
    inside = own["lower"] <= found.lower and found.upper <= own["upper"]
    width = own["upper"] - own["lower"]
    if inside or not width > 0 or not (found.upper - found.lower > 1.25 * width or not _overlap(own, found)):
        return ""
    return (
        f"{name} lies between {found.lower:.3g} and {found.upper:.3g} over the models (values {found.least:.3g} to "
        f"{found.most:.3g}), and between {own['lower']:.3g} and {own['upper']:.3g} by its own interval: which model is "
        "right matters more than noise."
    )


def _overlap(own: Mapping[str, float], found: ModelSpread) -> bool:
    return own["lower"] <= found.value <= own["upper"]


__all__ = ["Criterion", "ModelFit", "ModelSays", "ModelSpread", "Weights", "beyond", "in_words", "spread", "weigh"]
