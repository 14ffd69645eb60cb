"""The alternatives of a fit: each model fitted as the file's own is, their weights, and the spread of their answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from livlab.errors import InputError, Interrupted, LivlabError
from livlab.fitting.alternatives import ModelFit, ModelSays, ModelSpread, Weights, beyond, in_words, spread, weigh
from livlab.fitting.outcome import FitOutcome
from livlab.kinds.fit import tables
from livlab.kinds.fit.config import AS_GIVEN, FitExperiment
from livlab.kinds.fit.setup import FitSetup, MeasuredCurve

MODELS = (
    "alternative",
    "loss",
    "chi2_per_dof",
    "p",
    "numbers",
    "parameters",
    "aic",
    "bic",
    "weight",
    "weight_aic",
    "weight_bic",
    "settled",
    "lacks",
    "seconds",
    "error",
)
VALUES = ("alternative", "parameter", "path", "unit", "value", "lower", "upper", "sd", "status", "open", "weight")
SPREAD = (
    "parameter",
    "unit",
    "value",
    "lower",
    "upper",
    "weighted",
    "weighted_lower",
    "weighted_upper",
    "between",
    "least",
    "most",
    "models",
)


@dataclass(frozen=True, eq=False)
class OtherModel:
    """A model before it is fitted: its set-up, and what it lacks of the file's parameters."""

    setup: FitSetup
    lacks: tuple[str, ...]


def models_of(config: FitExperiment, curves: Mapping[str, MeasuredCurve]) -> dict[str, OtherModel]:
    """Every alternative set up, by name: what is wrong with one is told before any light.

    Raises
    ------
    InputError
        A model that cannot be fitted.
    """
    made = {}
    for alternative in config.alternative:
        own, said = config.version(alternative)
        try:
            made[alternative.name] = OtherModel(FitSetup.of(own, curves), tuple(said))
        except InputError as error:
            raise InputError(f"alternative {alternative.name}: {error.message}", remedy=error.remedy) from None
    return made


@dataclass(frozen=True, eq=False)
class Alternatives:
    """Models that were fitted beside the file's own, which stands first.

    Attributes
    ----------
    config
        The file.
    models
        By name, the file's own first.
    found
        What each fit found; or why it failed.
    """

    config: FitExperiment
    models: dict[str, OtherModel]
    found: dict[str, FitOutcome | LivlabError]

    @classmethod
    def fitted(
        cls,
        setup: FitSetup,
        own: FitOutcome,
        models: Mapping[str, OtherModel],
        *,
        progress: Callable[[str, float], None] | None = None,
        stopping: Callable[[], bool] | None = None,
    ) -> Self:
        """Each model fitted; one that fails is told and keeps no other from it.

        Parameters
        ----------
        setup, own
            The file's own model, and what was found with it.
        models
            The others, by name.
        progress
            Called with a model's name and its share done.
        stopping
            Asked whether the user wants to stop.

        Raises
        ------
        Interrupted
            The user wanted to stop.
        """
        found: dict[str, FitOutcome | LivlabError] = {AS_GIVEN: own}
        for name, model in models.items():

            def tell(stage: str, share: float, name: str = name) -> None:
                if progress is not None:
                    progress(name, share if stage == "search" else 0.0)

            try:
                found[name] = model.setup.search(progress=tell, stopping=stopping)
            except Interrupted:
                raise
            except LivlabError as error:
                found[name] = error
        return cls(setup.config, {AS_GIVEN: OtherModel(setup, ()), **models}, found)

    @property
    def good(self) -> dict[str, FitOutcome]:
        """The fits that came to an end."""
        return {name: x for name, x in self.found.items() if isinstance(x, FitOutcome)}

    def likelihoods(self) -> list[ModelFit]:
        """What the weights rest on, of each fit that came to an end."""
        return [ModelFit.of(x, self.models[name].setup.fitted) for name, x in self.good.items()]

    def weights(self) -> Weights:
        """Criteria and weights of the fits that came to an end."""
        return weigh(self.likelihoods())

    def table(self) -> list[dict[str, object]]:
        """Rows of alternatives.csv, a model each."""
        rows: list[dict[str, object]] = []
        weights = self.weights()
        chosen = weights.by(self.config.weigh_by)
        place = {name: k for k, name in enumerate(self.good)}
        fits = dict(zip(self.good, self.likelihoods(), strict=True))
        for name, x in self.found.items():
            row: dict[str, object] = {"alternative": name, "lacks": "; ".join(self.models[name].lacks)}
            if isinstance(x, FitOutcome):
                fit, k = fits[name], place[name]
                row |= {
                    "loss": x.loss,
                    "chi2_per_dof": _number(fit.loss / fit.dof) if fit.known and fit.dof > 0 else None,
                    "p": _number(fit.p),
                    "numbers": fit.numbers,
                    "parameters": fit.free,
                    "aic": _number(weights.aic[k]),
                    "bic": _number(weights.bic[k]),
                    "weight": _number(chosen[k]),
                    "weight_aic": _number(weights.by_aic[k]),
                    "weight_bic": _number(weights.by_bic[k]),
                    "settled": int(x.settled),
                    "seconds": sum(x.seconds.values()),
                }
            else:
                row["error"] = x.message
            rows.append(row)
        return rows

    def values(self) -> list[dict[str, object]]:
        """Rows of alternative_values.csv, a model's parameter each."""
        share = dict(zip(self.good, self.weights().by(self.config.weigh_by), strict=True))
        rows: list[dict[str, object]] = []
        for name, x in self.good.items():
            for row in tables.intervals(self.models[name].setup.config, x):
                kept = {k: row[k] for k in VALUES if k in row}
                rows.append({"alternative": name, **kept, "weight": _number(share[name])})
        return rows

    def spreads(self) -> dict[str, ModelSpread]:
        """By parameter, how far the models that have it lie apart; of what only one has, nothing."""
        said: dict[str, list[tuple[ModelSays, float]]] = {}
        for row in self.values():
            if str(row["status"]) != "fixed":
                numbers = (_float(row[k]) for k in ("value", "lower", "upper"))
                said.setdefault(str(row["parameter"]), []).append((ModelSays(*numbers), _float(row["weight"])))
        return {
            name: spread([e for e, _ in each], [w for _, w in each], self.config.level)
            for name, each in said.items()
            if len(each) > 1
        }

    def spread_table(self) -> list[dict[str, object]]:
        """Rows of spread.csv: the file's own value and interval, and beside it what the models together say."""
        own = {str(r["parameter"]): r for r in self.values() if r["alternative"] == AS_GIVEN}
        units = {str(r["parameter"]): r["unit"] for r in self.values()}
        return [
            {
                "parameter": name,
                "unit": units[name],
                **{k: own.get(name, {}).get(k) for k in ("value", "lower", "upper")},
                "weighted": x.value,
                "weighted_lower": _number(x.lower),
                "weighted_upper": _number(x.upper),
                "between": x.between,
                "least": x.least,
                "most": x.most,
                "models": x.models,
            }
            for name, x in self.spreads().items()
        ]

    def notes(self) -> list[str]:
        """What a report must say."""
        names = list(self.good)
        made = in_words(names, self.likelihoods(), self.weights(), self.config.weigh_by)
        for name, model in self.models.items():
            made += [f"The alternative “{name}” {'; '.join(model.lacks)}."] if model.lacks else []
            failed = self.found[name]
            if isinstance(failed, LivlabError):
                made.append(f"The alternative “{name}” could not be fitted: {failed.message}")
            elif name != AS_GIVEN and not failed.settled:
                made.append(f"The alternative “{name}” had not settled: its weight is rough.")
        own = {str(r["parameter"]): r for r in self.values() if r["alternative"] == AS_GIVEN}
        for name, x in self.spreads().items():
            if name in own:
                made.append(beyond(name, {k: _float(own[name][k]) for k in ("lower", "upper")}, x))
        return [text for text in made if text]


def _number(value: Any) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _float(value: Any) -> float:
    return float("nan") if value is None else float(value)


__all__ = ["MODELS", "SPREAD", "VALUES", "Alternatives", "OtherModel", "models_of"]
