"""Tables and curves that a fit job writes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from livlab.criteria import Claim
from livlab.fitting.outcome import FitOutcome
from livlab.fitting.targets import CurveTarget
from livlab.kinds.fit.config import FitExperiment
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.fitting.scenes import JointForward

INTERVALS = (
    "parameter",
    "path",
    "unit",
    "value",
    "lower",
    "upper",
    "sd",
    "sd_note",
    "drift",
    "status",
    "open",
    "start",
    "low",
    "high",
)
SCORES = (
    "measurement",
    "role",
    "points",
    "first_nm",
    "last_nm",
    "rmse",
    "pearson",
    "colour_difference",
    "rmse_start",
    "pearson_start",
)
COSTS = (
    "stage",
    "reading",
    "seconds",
    "evaluations",
    "samples",
    "samples_per_second",
    "solver",
    "error",
    "relative_error",
)


def named(text: str, config: FitExperiment) -> str:
    """A sentence with labels in place of paths."""
    for key, label in sorted(config.labels().items(), key=lambda pair: -len(pair[0])):
        text = text.replace(key, label)
    return text


def result(
    config: FitExperiment, best: Any, begin: FloatArray, targets: dict[str, CurveTarget], found: FitOutcome
) -> xr.Dataset:
    """Curves as they are and as they were compared; `begin` is the model at the start, nan where it is not known."""
    grid = config.wavelengths.grid()
    dims = ("measurement", "wavelength")
    shape = (len(targets), len(grid))
    model, data, sigma, start = (np.full(shape, np.nan) for _ in range(4))
    for k, target in enumerate(targets.values()):
        place, use = divmod(np.flatnonzero(target.use), len(grid))
        assert (place == place[0]).all()
        model[k, use], data[k, use], sigma[k, use] = target.normalised(best.value)
        start[k, use] = target.normalised(begin)[0]
    scenes = len(best.value) // len(grid)
    whole = ("wavelength",) if scenes == 1 else ("scene", "wavelength")

    def shaped(values: FloatArray) -> FloatArray:
        return values if scenes == 1 else values.reshape(scenes, -1)

    one = {"units": "1"}
    return xr.Dataset(
        {
            "reflectance": (whole, shaped(best.value), one),
            "reflectance_se": (whole, shaped(best.standard_error), one),
            "reflectance_start": (whole, shaped(begin), one),
            "model": (dims, model, one),
            "model_start": (dims, start, one),
            "data": (dims, data, one),
            "sigma": (dims, sigma, one),
        },
        coords={
            "wavelength": ("wavelength", grid, {"units": "nm"}),
            "measurement": list(targets),
            "role": ("measurement", [m.role for m in config.measurement if m.label in targets]),
        },
        attrs={
            "instrument": config.instrument.model_dump_json(),
            "loss": found.loss,
            "fresh_loss": found.fresh_loss,
            "settled": int(found.settled),
            "autocorrelation": found.autocorrelation,
            "verdict": found.verdict.verdict,
            "condition": found.verdict.condition,
            "evaluations": sum(s.evaluations for s in found.searches),
            "seed": config.seed,
            "level": config.level,
            **_misfit_attributes(found),
        },
    )


MISFIT = ("test", "where", "ratio", "chi2", "degrees_of_freedom", "p")


def misfit(found: FitOutcome) -> list[dict[str, object]]:
    """Rows of misfit.csv: the residuals as a whole, then each thing that they may hang on."""
    m = found.misfit
    whole: dict[str, object] = {
        "test": "residual over noise",
        "where": m.where,
        "ratio": _number(m.ratio),
        "chi2": _number(m.chi2),
        "degrees_of_freedom": _number(m.dof),
        "p": _number(m.p),
    }
    parts: list[dict[str, object]] = [
        {"test": s.name, "where": s.where, "ratio": _number(s.ratio), "degrees_of_freedom": s.dof or None,
         "p": _number(s.p)}
        for s in m.structure
    ]  # fmt: skip
    return [whole, *parts]


def misfit_record(found: FitOutcome) -> dict[str, object]:
    """The same for JSON, with what was made of it."""
    return {**found.misfit.to_dict(), "intervals_widened": found.widened, "words": found.misfit_words}


def _misfit_attributes(found: FitOutcome) -> dict[str, object]:
    m = found.misfit
    return {
        "misfit": found.misfit_words,
        "misfit_told": int(m.told),
        "misfit_noise": m.noise,
        "chi2": m.chi2,
        "degrees_of_freedom": m.dof,
        "p": m.p,
        "residual_over_noise": m.ratio,
        "intervals_widened": found.widened,
    }


def intervals(config: FitExperiment, found: FitOutcome) -> list[dict[str, object]]:
    """Rows of fit.csv, a parameter each."""
    frame = found.intervals()
    rows: list[dict[str, object]] = []
    for p in config.parameter:
        row = frame.loc[p.key]
        own = found.space.by_name[p.key]
        rows.append(
            {
                "parameter": p.name,
                "path": p.path,
                "unit": p.unit,
                **{k: _number(row[k]) for k in ("value", "lower", "upper", "sd", "drift")},
                "status": str(row["status"]),
                "open": str(row["open"]),
                "sd_note": str(row["sd_note"]),
                "start": own.start_value,
                "low": p.low,
                "high": p.high,
            }
        )
    return rows


def _number(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def scores(
    config: FitExperiment, targets: dict[str, CurveTarget], best: FloatArray, first: FloatArray
) -> list[dict[str, object]]:
    """Rows of scores.csv, a measurement each."""
    grid = config.wavelengths.grid()
    rows: list[dict[str, object]] = []
    for m in config.measurement:
        if m.label not in targets:
            continue
        target = targets[m.label]
        now, before = target.scores(best), target.scores(first)
        used = grid[np.flatnonzero(target.use) % len(grid)]
        rows.append(
            {
                "measurement": m.label,
                "role": m.role,
                "points": target.size,
                "first_nm": float(used[0]),
                "last_nm": float(used[-1]),
                "rmse": _number(now["rmse"]),
                "pearson": _number(now["pearson"]),
                "colour_difference": _number(now.get("colour difference")),
                "rmse_start": _number(before["rmse"]),
                "pearson_start": _number(before["pearson"]),
            }
        )
    return rows


def correlation(config: FitExperiment, found: FitOutcome) -> tuple[tuple[str, ...], list[dict[str, object]]]:
    """Columns and rows of correlation.csv."""
    labels = config.labels()
    frame = found.covariance.correlation.rename(index=labels, columns=labels)
    rows: list[dict[str, object]] = [
        {"parameter": str(name), **{str(k): _number(v) for k, v in row.items()}} for name, row in frame.iterrows()
    ]
    return ("parameter", *map(str, frame.columns)), rows


def path(config: FitExperiment, found: FitOutcome) -> tuple[tuple[str, ...], list[dict[str, object]]]:
    """Columns and rows of path.csv, an evaluation each."""
    frame = found.path.rename(columns=config.labels())
    columns = ("recording", *(str(c) for c in frame.columns if c != "recording"))
    return columns, [{str(k): v for k, v in row.items()} for row in frame[list(columns)].to_dict("records")]


def costs(reading: str, found: FitOutcome, forward: JointForward, best: Any) -> list[dict[str, object]]:
    """Rows of costs.csv: each walk, each search, and the intervals."""
    level = float(np.nanmax(best.value))
    rows: list[dict[str, object]] = [
        {
            "stage": "measure",
            "seconds": r["seconds"],
            "samples": r["photons"],
            "samples_per_second": float(r["photons"]) / float(r["seconds"]),  # type: ignore[arg-type]
            "solver": "ledger",
            "error": r["standard_error"],
            "relative_error": float(r["standard_error"]) / max(level, 1e-300),  # type: ignore[arg-type]
        }
        for r in forward.recordings
    ]
    rows += [{"stage": "search", "seconds": s.seconds, "evaluations": s.evaluations} for s in found.searches]
    rows.append({"stage": "uncertainty", "seconds": found.seconds["uncertainty"]})
    return [{"reading": reading, **row} for row in rows]


def claims(
    config: FitExperiment,
    scores: Sequence[dict[str, object]],
    found: FitOutcome,
    coverage: tuple[float, float] | None,
    reasons: dict[str, str],
    seconds: float,
) -> list[Claim]:
    """Every criterion judged; MISSING with its reason where the number is not to be had."""
    by_label = {str(s["measurement"]): s for s in scores}
    claims = []
    for c in config.criterion:
        value: Any
        error = 0.0
        if c.metric == "settled":
            value = float(found.settled)
        elif c.metric == "coverage":
            value, error = coverage or (None, 0.0)
        else:
            value = by_label.get(str(c.of), {}).get(c.metric.replace(" ", "_"))
        if value is None:
            why = reasons.get(str(c.of)) or f"{c.metric} of {c.of or 'round trips'} cannot be computed"
            claims.append(Claim.missing(c.name, why, aim=c.aim, seconds=seconds))
        else:
            drawn = "round trips" if c.metric == "coverage" else "samples"
            claims.append(Claim.judged(c.name, float(value), error, c.aim, seconds=seconds, samples=drawn))
    return claims
