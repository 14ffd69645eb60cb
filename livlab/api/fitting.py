"""Tissue values from measured curves in one call: `livlab.study.fit` over curves that are in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from livlab import markup
from livlab.api.curve import Spectrum
from livlab.api.simulate import ENDLESS, Part, TissueLike, part, readings_of, tissue
from livlab.api.sources import as_spectrum
from livlab.config import check_experiment
from livlab.criteria import format_with_error
from livlab.errors import InputError
from livlab.model.tissue.readings import READINGS, Reading
from livlab.model.tissue.tissue import Tissue, override
from livlab.study.fit_targets import Loss, Scaling, Target
from livlab.units import FloatArray

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from pydantic import BaseModel

    from livlab.config_fit import FitExperiment
    from livlab.study.fit import FitOutcome

Bounds = tuple[float, float] | tuple[float, float, float] | Mapping[str, Any]
"""Of a parameter: (low, high), (low, high, start), or a table as [[parameter]] in docs/studies.md."""


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """A finished fit; true in a condition if fresh draws gave the same parameters.

    Attributes
    ----------
    table
        Index label; path, unit, value, lower, upper, sd, drift, status, and `open`: ends that are bounds which the data
        do not exclude.
    scores
        Index measurement; points, rmse, pearson of the normalised curves, and the same at the start.
    correlation
        Of the free parameters.
    spectrum
        The model at the optimum, not normalised.
    measured
        The curves that were fitted, by label.
    tissue, reading
        The fitted tissue, and how it is read.
    level
        Coverage of the intervals.
    notes
        What is to be said: bounds reached, parameters that the data do not hold.
    outcome
        The whole record.
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
    targets: tuple[Target, ...] = field(default=())

    def __bool__(self) -> bool:
        return self.outcome.settled

    @property
    def values(self) -> dict[str, float]:
        """Value by label."""
        return {str(k): float(v) for k, v in self.table["value"].items()}

    def __repr__(self) -> str:
        found = ", ".join(
            f"{name} {format_with_error(_number(row['value']), _number(row['sd']))}"
            for name, row in self.table.iterrows()
        )
        return f"<FitResult {'settled' if self else 'not settled'}: {found}>"

    def _repr_html_(self) -> str:
        columns = ["parameter", "value", f"{self.level:.0%} interval", "unit", "status"]
        rows = [
            (
                name,
                format_with_error(_number(row["value"]), _number(row["sd"])),
                f"{row['lower']:.4g} to {row['upper']:.4g}" if np.isfinite(row["lower"]) else "–",
                row["unit"],
                row["status"],
            )
            for name, row in self.table.iterrows()
        ]
        scored = [(str(n), float(r["rmse"]), float(r["pearson"])) for n, r in self.scores.iterrows()]
        settled = "fresh draws gave the same values" if self else "fresh draws still move the values"
        return markup.card(
            f"Fit of {self.tissue.name}",
            f"{self.reading.name}; {settled}",
            markup.table(columns, rows),
            markup.table(["measurement", "rmse", "pearson"], scored),
            markup.notes(self.notes),
        )

    def to_pandas(self) -> pd.DataFrame:
        """The table of parameters."""
        return self.table.copy()

    def plot(self, ax: Axes | None = None) -> Axes:
        """Measured and fitted curves as they were compared; returns the axes."""
        from livlab.api.draw import axes

        ax = axes(ax)
        grid = self.spectrum.wavelength_nm
        for k, target in enumerate(self.targets):
            model, data, sigma = target.normalised(self.spectrum.value)
            x = grid[target.use]
            (line,) = ax.plot(x, data, "o", ms=3.5, label=f"{target.label}, measured")
            if np.isfinite(sigma).any():
                ax.errorbar(x, data, np.nan_to_num(sigma), ls="none", color=line.get_color(), alpha=0.5)
            ax.plot(x, model, color=line.get_color(), label="model" if k == 0 else None)
        ax.set_xlabel("wavelength [nm]")
        ax.set_ylabel("curve as compared")
        ax.legend()
        return ax


def fit(
    measured: Any,
    parameters: Mapping[str, Bounds],
    *,
    tissue: TissueLike = "liver",
    reading: str | Reading = "measured",
    state: str | None = None,
    variant: str = "whole",
    changes: Mapping[str, Any] | None = None,
    instrument: Part | BaseModel | None = None,
    band_nm: tuple[float, float] | None = None,
    scaling: Scaling = "max",
    loss: Loss = "rmse",
    level: float = 0.95,
    seed: int = 1,
    search: Mapping[str, Any] | None = None,
    device: Literal["llvm", "cuda"] = "llvm",
) -> FitResult:
    """Tissue values from measured curves, with intervals and what the data do not hold.

    One recorded walk answers for every trial; fresh walks then tell what the result owes to chance
    (docs/studies.md). `livlab run` on a file with kind = "fit" does the same and writes a report.

    Parameters
    ----------
    measured
        A spectrum (`Spectrum`, (wavelengths, values), pandas, colour-science, a CSV's path), or several by label.
    parameters
        By path in the tissue: {"layers.parenchyma.elements.blood.fraction": (0.01, 0.15)}; see `Bounds`.
    tissue, state, variant, changes
        As `livlab.tissue`; what is not fitted.
    reading
        As `livlab.spectrum`.
    instrument
        What saw the curves, as `livlab.spectrum`.
    band_nm
        First and last wavelength used; what the first curve has if not said. The model is compared at its wavelengths.
    scaling
        "max" or "sum" (shapes), "none" (absolute), "free" (the best factor).
    loss
        "rmse", "chi2" (needs standard errors), "pearson" or "colour".
    level
        Coverage of the intervals.
    seed
        Of the first walk.
    search
        As the section [search]: algorithm, starts, max_evaluations, max_seconds, standard_error, most_recordings.
    device
        Where it walks.

    Raises
    ------
    ConfigError, InputError
        No curve, no free parameter, a path that leads nowhere, bounds that do not rise, a curve without enough points.
    EnvironmentProblem
        There is no usable libLLVM.
    """
    from livlab.acquire.forward import LedgerForward
    from livlab.study.fit import fit as search_for

    curves = _curves(measured)
    first = next(iter(curves.values()))
    grid = first.between(*band_nm).wavelength_nm if band_nm is not None else first.wavelength_nm
    own = readings_of(reading)
    config = _experiment(
        curves,
        parameters,
        {
            "tissue": {"inline": _tissue(tissue, state, variant, changes)},
            "reading": own["reading"][0] if "reading" in own else _named(own["readings"][0]),
            "wavelengths": {"list_nm": [float(x) for x in grid]},
            "instrument": part("instrument", ENDLESS if instrument is None else instrument),
            "search": dict(search or {}),
            "level": level,
            "seed": seed,
            "variant": device,
        },
        scaling,
        loss,
    )
    targets = tuple(_target(label, s, grid, scaling, loss) for label, s in curves.items())
    chosen, wanted = config.tissue.build(), config.parameters()
    forward = LedgerForward(
        chosen,
        config.reading,
        grid,
        config.instrument,
        [p.name for p in wanted],
        standard_error=config.search.standard_error,
        variant=config.variant,
    )
    found = search_for(
        forward,
        targets,
        wanted,
        algorithm="auto" if config.search.algorithm == ("auto",) else config.search.algorithm,
        starts=config.search.starts,
        seed=config.seed,
        max_evaluations=config.search.max_evaluations,
        max_seconds=config.search.max_seconds,
        most_recordings=config.search.most_recordings,
        level=config.level,
    )
    best = forward.answer(found.best)
    begun = forward.answer(found.space.values(found.space.vector({})))
    labels = config.labels()
    said = [*forward.stack(found.best).notes, *found.notes, *found.verdict.sentences]
    for path, label in labels.items():
        said = [text.replace(path, label) for text in said]
    return FitResult(
        _table(config, found),
        _scores(targets, best.value, begun.value),
        found.covariance.correlation.rename(index=labels, columns=labels),
        Spectrum(grid, best.value, best.standard_error, f"{chosen.name}, fitted"),
        curves,
        override(chosen, found.best, by="fit"),
        config.reading,
        level,
        tuple(dict.fromkeys(said)),
        found,
        targets,
    )


def _curves(measured: Any) -> dict[str, Spectrum]:
    """Curves by label."""
    if isinstance(measured, Mapping):
        if not measured:
            raise InputError.of("measured", measured, "holds no curve", "Give one or more by label.")
        return {str(label): as_spectrum(given, str(label)) for label, given in measured.items()}
    one = as_spectrum(measured, "measured")
    return {one.name.strip()[:80] or "measured": one}


def _experiment(
    curves: Mapping[str, Spectrum], parameters: Mapping[str, Bounds], rest: dict[str, Any], scaling: str, loss: str
) -> FitExperiment:
    """The call as an experiment, so that it is checked as a file's would be; its curves are named, not looked up."""
    from livlab.config_fit import FitExperiment

    if not isinstance(parameters, Mapping) or not parameters:
        raise InputError.of("parameters", parameters, "must be bounds by path", "Give {path: (low, high)}.")
    data = {
        "kind": "fit",
        "name": "fit",
        "parameter": [_parameter(path, bounds) for path, bounds in parameters.items()],
        # An error of each point is looked up in the curve itself; the form wants one named where chi2 is asked.
        "measurement": [
            {"label": label, "dataset": "in-memory", "scaling": scaling, "loss": loss}
            | ({"sd_column": "standard_error"} if loss == "chi2" else {})
            for label in curves
        ],
        **rest,
    }
    found = check_experiment(data, source="livlab.fit").resolve()
    assert isinstance(found, FitExperiment)
    return found


def _parameter(path: str, bounds: Bounds) -> dict[str, Any]:
    if isinstance(bounds, Mapping):
        return {"path": path, **bounds}
    if isinstance(bounds, Sequence) and len(bounds) in (2, 3):
        return {"path": path, **dict(zip(("low", "high", "start"), (float(b) for b in bounds), strict=False))}
    raise InputError.of(f"parameters[{path!r}]", bounds, "must be (low, high) or (low, high, start)", "Give bounds.")


def _named(name: str) -> Reading:
    if name not in READINGS:
        raise InputError.of("reading", name, f"must be one of {', '.join(READINGS)}", "Name one, or give a Reading.")
    return READINGS[name]


def _tissue(given: TissueLike, state: str | None, variant: str, changes: Mapping[str, Any] | None) -> Tissue:
    return tissue(given, state=state, variant=variant, changes=changes)


def _target(label: str, s: Spectrum, grid: FloatArray, scaling: Scaling, loss: Loss) -> Target:
    inside = (grid >= s.wavelength_nm[0]) & (grid <= s.wavelength_nm[-1])
    data, sigma = np.full(len(grid), np.nan), np.full(len(grid), np.nan)
    data[inside] = s.at(grid[inside])
    sigma[inside] = np.interp(grid[inside], s.wavelength_nm, s.standard_error)
    colour = None
    if loss == "colour":
        from livlab.study.fit_job import lab_of

        colour = lab_of(grid[inside])
    return Target(label, inside, data, sigma, scaling, loss, 1.0, colour)


def _table(config: FitExperiment, found: FitOutcome) -> pd.DataFrame:
    frame = found.intervals().rename_axis("path").reset_index()
    frame.insert(0, "parameter", [config.labels()[str(p)] for p in frame["path"]])
    units = {p.path: p.unit for p in config.parameter}
    frame["unit"] = [units[str(p)] for p in frame["path"]]
    return frame.set_index("parameter")[["path", "unit", "value", "lower", "upper", "sd", "drift", "status", "open"]]


def _scores(targets: Sequence[Target], best: FloatArray, first: FloatArray) -> pd.DataFrame:
    import pandas as pd

    rows = {}
    for target in targets:
        now, before = target.scores(best), target.scores(first)
        rows[target.label] = (target.size, now["rmse"], now["pearson"], before["rmse"], before["pearson"])
    columns = ["points", "rmse", "pearson", "rmse_start", "pearson_start"]
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    frame.index.name = "measurement"
    return frame


def _number(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
