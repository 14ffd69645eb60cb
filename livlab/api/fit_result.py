"""What a fit in a notebook gives: values with intervals, curves, notes, and the alternatives if there were any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.api.curve import Spectrum
from livlab.core import markup
from livlab.criteria import format_with_error
from livlab.fitting.targets import CurveTarget
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.tissue import Tissue
from livlab.units import FloatArray

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from livlab.fitting.outcome import FitOutcome
    from livlab.optimise.misfit import Misfit

WORDS = {"path", "unit", "status", "open", "sd_note", "role", "lacks", "error"}
"""Columns that hold no numbers."""


def frame(rows: Sequence[dict[str, object]], index: str, columns: Sequence[str]) -> pd.DataFrame:
    """Rows as a table, what is missing as nan."""
    import pandas as pd

    made = pd.DataFrame(rows, columns=[index, *columns]).set_index(index)
    return made.astype({c: float for c in columns if c not in WORDS and c != "points"})


def _empty(index: str) -> pd.DataFrame:
    return frame([], index, ())


def _number(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _shown(row: pd.Series, ends: bool = True) -> str:
    """Value ± sd, or where that says something else than the interval, value and interval (or the value alone)."""
    value, sd = _number(row["value"]), _number(row["sd"])
    if not row["sd_note"]:
        return format_with_error(value, sd)
    low, high = float(row["lower"]), float(row["upper"])
    if not (np.isfinite(low) and np.isfinite(high)):
        return format_with_error(value, None)
    width = high - low
    shown = format_with_error(value, width / 4).partition(" ")[0] if width > 0 else format_with_error(value, None)
    return f"{shown} ({low:.3g} to {high:.3g})" if ends else shown


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """A finished fit; true in a condition if fresh draws gave the same parameters and the model fits, or may.

    Attributes
    ----------
    table
        Index label; path, unit, value, lower, upper, sd, drift, status, `open`: ends that are bounds which the data
        do not exclude, and `sd_note`: why value ± sd is not what the data say, if so.
    scores
        Index measurement; role, points, rmse, pearson of the normalised curves, and the same at the start (nan where
        the last walk cannot answer for the start).
    correlation
        Of the free parameters.
    spectrum, spectra
        The model at the optimum, not normalised: of the first measurement's tissue, and of each measurement's by label.
    measured
        The curves that were given, by label.
    tissue, tissues, reading
        The fitted tissue of the first measurement, of each measurement by label, and how it is read.
    level
        Coverage of the intervals.
    notes
        What is to be said: how well the model fits, bounds reached, parameters that the data do not hold.
    outcome
        The whole record.
    alternatives
        Index alternative, the model as given first; loss, chi2_per_dof, p, aic, bic, weight and more; empty without
        alternatives.
    spread
        Index parameter: its own value and interval, and what the models together say: weighted mean and interval
        (`weighted`, `weighted_lower`, `weighted_upper`), `least` and `most` of the values.
    fits
        The fit of each alternative that came to an end, by name.
    """

    table: pd.DataFrame
    scores: pd.DataFrame
    correlation: pd.DataFrame
    spectrum: Spectrum
    measured: dict[str, Spectrum]
    tissue: Tissue
    reading: Reading
    level: float
    notes: tuple[str, ...]
    outcome: FitOutcome
    targets: tuple[CurveTarget, ...] = field(default=())
    spectra: dict[str, Spectrum] = field(default_factory=dict)
    tissues: dict[str, Tissue] = field(default_factory=dict)
    joint: FloatArray = field(default_factory=lambda: np.empty(0))
    alternatives: pd.DataFrame = field(default_factory=lambda: _empty("alternative"))
    spread: pd.DataFrame = field(default_factory=lambda: _empty("parameter"))
    fits: dict[str, FitResult] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.outcome)

    @property
    def misfit(self) -> Misfit:
        """How far the model misses the measured curves: χ², degrees of freedom, p, residual over noise, structure."""
        return self.outcome.misfit

    @property
    def misfit_words(self) -> str:
        """How well the model describes the data, in a sentence."""
        return self.outcome.misfit_words

    @property
    def values(self) -> dict[str, float]:
        """Value by label."""
        return {str(k): float(v) for k, v in self.table["value"].items()}

    def __repr__(self) -> str:
        found = ", ".join(f"{name} {_shown(row)}{self._over_models(str(name))}" for name, row in self.table.iterrows())
        settled = "settled" if self.outcome.settled else "not settled"
        return f"<FitResult {settled}: {found}; {self.misfit_words}>"

    def _over_models(self, name: str) -> str:
        """The spread of a parameter over the alternatives in brackets; empty where there is none."""
        if name not in self.spread.index:
            return ""
        low, high, models = (float(self.spread[k][name]) for k in ("weighted_lower", "weighted_upper", "models"))
        return f" (over {models:.0f} models {low:.3g} to {high:.3g})"

    def _repr_html_(self) -> str:
        columns = ["parameter", "value", f"{self.level:.0%} interval", "unit", "status"]
        rows = [
            (
                name,
                _shown(row, ends=False),
                f"{row['lower']:.4g} to {row['upper']:.4g}" if np.isfinite(row["lower"]) else "–",
                row["unit"],
                row["status"],
            )
            for name, row in self.table.iterrows()
        ]
        scored = [(str(n), float(r["rmse"]), float(r["pearson"])) for n, r in self.scores.iterrows()]
        settled = "fresh draws gave the same values" if self.outcome.settled else "fresh draws still move the values"
        return markup.card(
            f"Fit of {self.tissue.name}",
            f"{self.reading.name}; {settled}",
            markup.warning(self.misfit_words) if self.misfit.told else markup.notes([self.misfit_words]),
            markup.table(columns, rows),
            markup.table(["measurement", "rmse", "pearson"], scored),
            *self._models_as_html(),
            markup.notes(text for text in self.notes if text != self.misfit_words),
        )

    def _models_as_html(self) -> list[str]:
        """The alternatives, and the spread of each parameter beside its interval."""
        if not len(self.alternatives):
            return []
        models = [
            (str(n), *(f"{float(r[k]):.3g}" if np.isfinite(r[k]) else "–" for k in ("loss", "aic", "bic", "weight")))
            for n, r in self.alternatives.iterrows()
        ]
        spread = [
            (
                str(n),
                f"{r['lower']:.4g} to {r['upper']:.4g}" if np.isfinite(r["lower"]) else "–",
                f"{r['weighted']:.4g}, {r['weighted_lower']:.4g} to {r['weighted_upper']:.4g}",
                f"{r['least']:.4g} to {r['most']:.4g}",
            )
            for n, r in self.spread.iterrows()
        ]
        return [
            markup.table(["model", "loss", "AIC", "BIC", "weight"], models),
            markup.table(["parameter", "its interval", "over the models, weighted", "values, least to most"], spread),
        ]

    def to_pandas(self) -> pd.DataFrame:
        """The table of parameters."""
        return self.table.copy()

    def plot(self, ax: Axes | None = None) -> Axes:
        """Measured and fitted curves as they were compared; returns the axes."""
        from livlab.api.draw import axes

        ax = axes(ax)
        grid = np.resize(self.spectrum.wavelength_nm, len(self.joint))
        for k, target in enumerate(self.targets):
            model, data, sigma = target.normalised(self.joint)
            x = grid[target.use]
            (line,) = ax.plot(x, data, "o", ms=3.5, label=f"{target.label}, measured")
            if np.isfinite(sigma).any():
                ax.errorbar(x, data, np.nan_to_num(sigma), ls="none", color=line.get_color(), alpha=0.5)
            ax.plot(x, model, color=line.get_color(), label="model" if k == 0 else None)
        ax.set_xlabel("wavelength [nm]")
        ax.set_ylabel("curve as compared")
        ax.legend()
        return ax


__all__ = ["FitResult", "frame"]
