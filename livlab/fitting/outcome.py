"""What a fit leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import pandas as pd

from livlab.fitting.intervals import ProfileInterval
from livlab.fitting.misfit import words
from livlab.optimise import Covariance, Identifiability, OptimiseResult, ParameterSpace
from livlab.optimise.covariance import normal_quantile
from livlab.optimise.misfit import Misfit


@dataclass(frozen=True, eq=False, kw_only=True)
class FitOutcome:
    """A finished fit.

    Attributes
    ----------
    best, space
        Every parameter's value by name, and the parameters.
    loss, fresh_loss
        Σ r² at the optimum, with the draws of the search and with fresh ones.
    searches
        One result a recording, the last one first in trust.
    drift
        Change of each free parameter from the last recording but one to the last: what it owes to chance.
    settled
        Whether fresh draws moved no parameter by more than a share of its standard deviation.
    covariance
        At the optimum, of the residuals; scaled by `residual_scale`.
    residual_scale
        Factor on the covariance: `widened` squared where every σ is known (chi2), else what the residuals show.
    autocorrelation
        Of neighbouring residuals; their scale counts fewer points where it is high.
    misfit
        How far the model misses the measured curves: χ² over its degrees of freedom, its p, tests of structure.
    widened
        Factor by which a chi2's intervals and sd are wider than the stated errors say, since χ² is unlikely.
    by_residuals
        Whether intervals take the noise from the residuals, and so the misfit for noise.
    verdict
        What the data do not hold.
    profiled
        Profile-likelihood interval of each free parameter at `level`, also of those at a bound.
    level
        Coverage that the intervals claim.
    notes
        Sentences that a report must show.
    seconds
        By stage.
    """

    best: dict[str, float]
    space: ParameterSpace
    loss: float
    fresh_loss: float

    searches: tuple[OptimiseResult, ...]
    drift: dict[str, float]
    settled: bool

    covariance: Covariance
    residual_scale: float
    autocorrelation: float
    misfit: Misfit
    widened: float
    by_residuals: bool
    verdict: Identifiability

    profiled: Mapping[str, ProfileInterval]
    level: float

    notes: tuple[str, ...]
    seconds: Mapping[str, float]
    path: pd.DataFrame = field(repr=False)

    def __bool__(self) -> bool:
        """Whether fresh draws gave the same parameters, and the model is not known to miss the data."""
        return self.settled and not self.misfit.told

    @property
    def misfit_words(self) -> str:
        """How well the model describes the data, in a sentence."""
        return words(self.misfit, self.widened, self.by_residuals)

    def intervals(self) -> pd.DataFrame:
        """Lower, value, upper (profile likelihood), sd, status, open, drift by parameter; fixed ones have no interval.

        `open` says which ends are bounds that the data do not exclude: "", "below", "above" or "both". `sd_note` says
        where value ± sd is not what the data say: "at a bound", "conditional" (on another that sits at its bound) or
        "skew" (the interval is not even about the value).
        """
        rows = {}
        for name, value in self.best.items():
            p = self.space.by_name[name]
            found, factor = self.profiled.get(p.tied or name), p.factor if p.tied else 1.0
            ends = sorted((factor * found.lower, factor * found.upper)) if found is not None else [math.nan, math.nan]
            sides = (found.open_below, found.open_above) if found is not None else (False, False)
            rows[name] = {
                "lower": ends[0],
                "value": value,
                "upper": ends[1],
                "sd": self.covariance.sd.get(name, math.nan),
                "status": self.searches[-1].status[name],
                "drift": self.drift.get(name, math.nan),
                "open": _OPEN[sides[::-1] if factor < 0 else sides],
            }
            rows[name]["sd_note"] = self._sd_note(p.tied or name, found)
        made = pd.DataFrame.from_dict(rows, orient="index")
        made.index.name = "parameter"
        return made

    def _sd_note(self, name: str, found: ProfileInterval | None) -> str:
        """Why ± sd says something else than the interval; nothing where both agree."""
        if found is None:
            return ""
        if name in self.covariance.held:
            return "at a bound"
        sd, value = self.covariance.sd.get(name, math.nan), self.best[name]
        half = normal_quantile(self.level) * sd
        sides = (value - found.lower, found.upper - value)
        if math.isfinite(half) and all(half / ALIKE <= side <= half * ALIKE for side in sides):
            return ""
        even = min(sides) > 0 and max(sides) <= ALIKE * min(sides)
        return "conditional" if self.covariance.held and (even or max(sides) > ALIKE * half) else "skew"


ALIKE = 1.3
"""Factor within which both sides of an interval are what the standard deviation says."""

_OPEN = {(False, False): "", (True, False): "below", (False, True): "above", (True, True): "both"}
