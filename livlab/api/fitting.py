"""Tissue values from measured curves in one call: `livlab.fitting.fit` over curves that are in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from livlab.api.arguments import explained
from livlab.api.curve import Spectrum
from livlab.api.fit_result import FitResult, frame
from livlab.api.simulate import ENDLESS, Part, TissueLike, part, readings_of, tissue
from livlab.api.sources import as_spectrum
from livlab.config.load import check_experiment
from livlab.errors import InputError
from livlab.fitting.targets import Loss, Scaling
from livlab.model.tissue.readings import READINGS, Reading
from livlab.model.tissue.tissue import Tissue
from livlab.units import FloatArray

if TYPE_CHECKING:
    from pydantic import BaseModel

    from livlab.fitting.outcome import FitOutcome
    from livlab.kinds.fit.alternatives import Alternatives
    from livlab.kinds.fit.config import FitExperiment
    from livlab.kinds.fit.setup import FitSetup, MeasuredCurve

Bounds = tuple[float, float] | tuple[float, float, float] | Mapping[str, Any] | Sequence[Mapping[str, Any]]
"""Of a parameter: (low, high), (low, high, start), or a table as [[parameter]] in docs/studies.md; a list of tables
where the tissues measured have each its own (`only`)."""


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
    alternatives: Mapping[str, Mapping[str, Any]] | None = None,
    weigh_by: Literal["aic", "bic"] = "aic",
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
    alternatives
        Other models to fit as well, by name, as [[alternative]] in docs/studies.md: variant, layers, reading, set, and
        parameters of its own: {"no capsule": {"variant": "parenchyma_only"}, "two laws": {"set": {path: value},
        "parameters": {path: (low, high)}}}.
    weigh_by
        Criterion by which the models are weighed.
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
    from livlab.kinds.fit.alternatives import Alternatives, models_of
    from livlab.kinds.fit.setup import FitSetup

    curves = _curves(measured)
    first = next(iter(curves.values()))
    grid = first.between(*band_nm).wavelength_nm if band_nm is not None else first.wavelength_nm
    read = readings_of(reading)
    config = _experiment(
        curves,
        parameters,
        {
            "tissue": _spec(tissue, state, variant, changes, whole=not alternatives),
            "reading": read["reading"][0] if "reading" in read else _named(read["readings"][0]),
            "wavelengths": {"list_nm": [float(x) for x in grid]},
            "instrument": part("instrument", ENDLESS if instrument is None else instrument),
            "search": dict(search or {}),
            "alternative": [_alternative(name, given) for name, given in (alternatives or {}).items()],
            "weigh_by": weigh_by,
            "level": level,
            "seed": seed,
            "variant": device,
        },
        {label: _asked(measurements, curves, label, scaling, loss) for label in curves},
    )
    own = {label: _curve(s, grid) for label, s in curves.items()}
    setup, models = FitSetup.of(config, own), models_of(config, own)
    found = setup.search()
    if not models:
        return _result(setup, curves, found)
    return _beside(curves, _result(setup, curves, found), Alternatives.fitted(setup, found, models))


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
        table=frame(fit_tables.intervals(config, found), "parameter", _INTERVALS),
        scores=frame(fit_tables.scores(config, setup.targets, best.value, begun), "measurement", _SCORES),
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


def _beside(curves: dict[str, Spectrum], result: FitResult, models: Alternatives) -> FitResult:
    """A finished fit with those of its alternatives."""
    from livlab.kinds.fit.alternatives import MODELS, SPREAD

    others = {name: x for name, x in models.good.items() if x is not result.outcome}
    return replace(
        result,
        alternatives=frame(models.table(), "alternative", MODELS[1:]),
        spread=frame(models.spread_table(), "parameter", SPREAD[1:]),
        fits={name: _result(models.models[name].setup, curves, x) for name, x in others.items()},
        notes=(*models.notes(), *result.notes),
    )


_INTERVALS = ("path", "unit", "value", "lower", "upper", "sd", "drift", "status", "open", "sd_note")
_SCORES = ("role", "points", "rmse", "pearson", "rmse_start", "pearson_start")


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


def _alternative(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """An alternative as a file has it; its parameters are bounds by path, as those of the fit."""
    if not isinstance(given, Mapping):
        raise InputError.of(f"alternatives[{name!r}]", given, "must be a table", "Give {'variant': …, 'set': {…}}.")
    rest = {k: v for k, v in given.items() if k != "parameters"}
    own = [table for path, bounds in dict(given.get("parameters", {})).items() for table in _parameter(path, bounds)]
    return {"name": str(name), **rest, **({"parameter": own} if own else {})}


def _spec(
    given: TissueLike, state: str | None, variant: str, changes: Mapping[str, Any] | None, *, whole: bool
) -> dict[str, Any]:
    """The tissue as a file has it: written out if `whole`, else a preset by name, whose variants can be named."""
    if whole or not isinstance(given, (str, Path)):
        return {"inline": _tissue(given, state, variant, changes)}
    named = {"preset": str(given), "variant": variant, "set": dict(changes or {})}
    return named if state is None else {**named, "state": state}


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
