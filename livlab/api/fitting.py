"""Tissue values from measured curves in one call: `livlab.fitting.fit` over curves that are in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from livlab.api.arguments import explained
from livlab.api.curve import Spectrum
from livlab.api.simulate import ENDLESS, Part, TissueLike, part, readings_of, tissue
from livlab.api.sources import as_spectrum
from livlab.config.load import check_experiment
from livlab.core import markup
from livlab.criteria import format_with_error
from livlab.errors import InputError
from livlab.fitting.targets import CurveTarget, Loss, Scaling
from livlab.model.tissue.readings import READINGS, Reading
from livlab.model.tissue.tissue import Tissue
from livlab.units import FloatArray

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from pydantic import BaseModel

    from livlab.fitting.outcome import FitOutcome
    from livlab.kinds.fit.config import FitExperiment
    from livlab.kinds.fit.setup import FitSetup, MeasuredCurve

Bounds = tuple[float, float] | tuple[float, float, float] | Mapping[str, Any] | Sequence[Mapping[str, Any]]
"""Of a parameter: (low, high), (low, high, start), or a table as [[parameter]] in docs/studies.md; a list of tables
where the tissues measured have each its own (`only`)."""


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """A finished fit; true in a condition if fresh draws gave the same parameters.

    Attributes
    ----------
    table
        Index label; path, unit, value, lower, upper, sd, drift, status, and `open`: ends that are bounds which the data
        do not exclude.
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
    targets: tuple[CurveTarget, ...] = field(default=())
    spectra: dict[str, Spectrum] = field(default_factory=dict)
    tissues: dict[str, Tissue] = field(default_factory=dict)
    joint: FloatArray = field(default_factory=lambda: np.empty(0))

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


@explained
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
    measurements: Mapping[str, Mapping[str, Any]] | None = None,
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
        By path in the tissue: {"layers.parenchyma.elements.blood.fraction": (0.01, 0.15)}; see `Bounds`. Where two
        measured tissues differ: {path: [{"low": 0, "high": 1, "label": "a", "only": ["clamped"]}, ...]}.
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
    measurements
        What differs from that for single curves, by label, as [[measurement]] in docs/studies.md: band_nm, scaling,
        loss, weight, sd, relative_sd, role ("check": not fitted, looked at), set (values by path of that tissue).
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
    from livlab.kinds.fit.setup import FitSetup

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
        {label: _asked(measurements, curves, label, scaling, loss) for label in curves},
    )
    setup = FitSetup.of(config, {label: _curve(s, grid) for label, s in curves.items()})
    return _result(setup, curves, setup.search())


def _result(setup: FitSetup, curves: dict[str, Spectrum], found: FitOutcome) -> FitResult:
    """A finished fit as the notebook shows it."""
    from livlab.kinds.fit import tables as fit_tables
    from livlab.kinds.fit.setup import scene_of

    config, labels, scenes = setup.config, setup.config.labels(), setup.config.scenes()
    grid = config.wavelengths.grid()
    best, begun = setup.curves(found)
    tissues = {label: setup.tissue(label, found.best) for label in curves}
    spectra = {}
    for label in curves:
        place = scene_of(scenes, label)
        part_of = slice(place * len(grid), (place + 1) * len(grid))
        spectra[label] = Spectrum(
            grid, best.value[part_of], best.standard_error[part_of], f"{tissues[label].name}, fitted"
        )
    one = config.measurement[0].label
    return FitResult(
        table=_frame(fit_tables.intervals(config, found), "parameter", _INTERVALS),
        scores=_frame(fit_tables.scores(config, setup.targets, best.value, begun), "measurement", _SCORES),
        correlation=found.covariance.correlation.rename(index=labels, columns=labels),
        spectrum=spectra[one],
        spectra=spectra,
        measured=curves,
        tissue=tissues[one],
        tissues=tissues,
        reading=config.reading,
        level=config.level,
        notes=tuple(setup.said(found)),
        outcome=found,
        targets=tuple(setup.targets.values()),
        joint=best.value,
    )


_INTERVALS = ("path", "unit", "value", "lower", "upper", "sd", "drift", "status", "open")
_SCORES = ("role", "points", "rmse", "pearson", "rmse_start", "pearson_start")
_WORDS = {"path", "unit", "status", "open", "role"}


def _curves(measured: Any) -> dict[str, Spectrum]:
    """Curves by label."""
    if isinstance(measured, Mapping):
        if not measured:
            raise InputError.of("measured", measured, "holds no curve", "Give one or more by label.")
        return {str(label): as_spectrum(given, str(label)) for label, given in measured.items()}
    one = as_spectrum(measured, "measured")
    return {one.name.strip()[:80] or "measured": one}


def _asked(
    given: Mapping[str, Mapping[str, Any]] | None,
    curves: Mapping[str, Spectrum],
    label: str,
    scaling: str,
    loss: str,
) -> dict[str, Any]:
    """A curve as a [[measurement]]; it is named, not looked up, and brings its own errors.

    Raises
    ------
    InputError
        Something said of a curve that there is none of, or that the curve itself says.
    """
    from livlab.config.errors import nearest

    for name, said in (given or {}).items():
        if name not in curves:
            hint = nearest(name, curves) or f"Known: {', '.join(curves)}."
            raise InputError.of("measurements", name, "names no curve", hint)
        taken = next((k for k in ("label", "dataset", "column", "sd_column", "subjects") if k in said), None)
        if taken is not None:
            raise InputError.of(f"measurements[{name!r}]", taken, "is the curve's own", "Leave it out.")
    data = {"label": label, "dataset": "in-memory", "scaling": scaling, "loss": loss, **(given or {}).get(label, {})}
    known = bool(np.isfinite(curves[label].standard_error).any())
    if not {"sd", "relative_sd"} & set(data) and (known or data["loss"] == "chi2"):
        data["sd_column"] = "standard_error"
    return data


def _experiment(
    curves: Mapping[str, Spectrum],
    parameters: Mapping[str, Bounds],
    rest: dict[str, Any],
    measurements: Mapping[str, dict[str, Any]],
) -> FitExperiment:
    """The call as an experiment, so that it is checked as a file's would be."""
    from livlab.kinds.fit.config import FitExperiment

    if not isinstance(parameters, Mapping) or not parameters:
        raise InputError.of("parameters", parameters, "must be bounds by path", "Give {path: (low, high)}.")
    data = {
        "kind": "fit",
        "name": "fit",
        "parameter": [table for path, bounds in parameters.items() for table in _parameter(path, bounds)],
        "measurement": list(measurements.values()),
        **rest,
    }
    found = check_experiment(data, source="livlab.fit").resolve()
    assert isinstance(found, FitExperiment)
    return found


def _parameter(path: str, bounds: Bounds) -> list[dict[str, Any]]:
    if isinstance(bounds, Mapping):
        return [{"path": path, **bounds}]
    if isinstance(bounds, Sequence) and bounds and all(isinstance(b, Mapping) for b in bounds):
        return [{"path": path, **b} for b in bounds]  # type: ignore[dict-item]
    if isinstance(bounds, Sequence) and len(bounds) in (2, 3):
        numbers = (float(b) for b in bounds)  # type: ignore[arg-type]
        return [{"path": path, **dict(zip(("low", "high", "start"), numbers, strict=False))}]
    raise InputError.of(f"parameters[{path!r}]", bounds, "must be (low, high) or (low, high, start)", "Give bounds.")


def _named(name: str) -> Reading:
    if name not in READINGS:
        raise InputError.of("reading", name, f"must be one of {', '.join(READINGS)}", "Name one, or give a Reading.")
    return READINGS[name]


def _tissue(given: TissueLike, state: str | None, variant: str, changes: Mapping[str, Any] | None) -> Tissue:
    return tissue(given, state=state, variant=variant, changes=changes)


def _curve(s: Spectrum, grid: FloatArray) -> MeasuredCurve:
    from livlab.kinds.fit.setup import MeasuredCurve

    ends = float(s.wavelength_nm[0]), float(s.wavelength_nm[-1])
    inside = (grid >= ends[0]) & (grid <= ends[1])
    data, sd = np.full(len(grid), np.nan), np.full(len(grid), np.nan)
    data[inside] = s.at(grid[inside])
    sd[inside] = np.interp(grid[inside], s.wavelength_nm, s.standard_error)
    return MeasuredCurve(data, sd, np.asarray(s.wavelength_nm, dtype=np.float64))


def _frame(rows: list[dict[str, object]], index: str, columns: tuple[str, ...]) -> pd.DataFrame:
    import pandas as pd

    made = pd.DataFrame(rows).set_index(index)[list(columns)]
    return made.astype({c: float for c in columns if c not in _WORDS and c != "points"})


def _number(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
