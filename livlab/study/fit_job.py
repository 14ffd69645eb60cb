"""The fit job: measured curves → targets → search with fresh draws → intervals, checks on unseen bands, claims."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from livlab.acquire.forward import LedgerForward
from livlab.config_fit import FitExperiment, Measurement
from livlab.config_spectral import Reference
from livlab.criteria import Claim
from livlab.errors import InputError, Interrupted
from livlab.gpu import name_device
from livlab.study import spectral_tables as tables
from livlab.study.fit import GUIDE, FitOutcome, fit
from livlab.study.fit_targets import Target
from livlab.study.spectral_claims import Known, load_reference
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.runs_work import Run

INTERVALS = ("parameter", "path", "unit", "value", "lower", "upper", "sd", "drift", "status", "start", "low", "high")
SCORES = ("measurement", "role", "points", "first_nm", "last_nm", "rmse", "pearson", "rmse_start", "pearson_start")
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


def prepare(config: FitExperiment) -> Callable[[Run], None]:
    """Everything that can go wrong before light is followed: datasets, bands, the tissue at the start.

    Raises
    ------
    InputError
        A measurement without enough points on the wavelengths, or none to fit that is to be had.
    DatasetError, RangeError
        A dataset that is damaged, or does not reach.
    """
    known = [_load(m) for m in config.measurement]
    grid = config.wavelengths.grid()
    targets = {m.label: _target(m, k, grid) for m, k in zip(config.measurement, known, strict=True) if k.dataset}
    if not any(m.role == "fit" and m.label in targets for m in config.measurement):
        raise InputError.of(
            "measurement", "none available", known[0].reason or "has no numbers", "Add the data: livlab data add FILE."
        )
    parameters = config.parameters()
    forward = LedgerForward(
        config.tissue.build(),
        config.reading,
        grid,
        config.instrument,
        [p.name for p in parameters],
        standard_error=config.search.standard_error,
        variant=config.variant,
    )
    forward.stack({p.name: p.start_value for p in parameters if p.tied is None} | _tied(parameters))
    return lambda run: _work(run, config, forward, parameters, targets, known)


def _tied(parameters: Sequence[Any]) -> dict[str, float]:
    by_name = {p.name: p for p in parameters}
    return {p.name: p.factor * by_name[p.tied].start_value for p in parameters if p.tied is not None}


def _load(m: Measurement) -> Known:
    return load_reference(
        Reference(label=m.label, dataset=m.dataset, column=m.column, sd_column=m.sd_column, subjects=m.subjects)
    )


def _target(m: Measurement, known: Known, grid: FloatArray) -> Target:
    data, sd = known.at(grid)
    if m.sd_column is not None and sd is not None:
        sigma = sd / np.sqrt(m.subjects)
    elif m.sd is not None:
        sigma = np.full_like(data, m.sd)
    elif m.relative_sd is not None:
        sigma = m.relative_sd * np.abs(data)
    else:
        sigma = np.full_like(data, np.nan)
    use = np.isfinite(data)
    if m.band_nm is not None:
        use &= (grid >= m.band_nm[0]) & (grid <= m.band_nm[1])
    colour = lab_of(grid[use]) if m.loss == "colour" else None
    return Target(m.label, use, data, sigma, m.scaling, m.loss, m.weight, colour)


def lab_of(wavelength_nm: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """CIE L*a*b* of a reflectance under D65 for the 2° observer, white being a perfect diffuser."""
    from livlab.model.colour import cie_weights

    weights = cie_weights(wavelength_nm).transpose("channel", "wavelength").to_numpy()

    def lab(curve: FloatArray) -> FloatArray:
        from colour import RGB_COLOURSPACES, RGB_to_XYZ, XYZ_to_Lab

        return np.asarray(XYZ_to_Lab(RGB_to_XYZ(weights @ curve, RGB_COLOURSPACES["sRGB"])))

    return lab


def _work(
    run: Run,
    config: FitExperiment,
    forward: LedgerForward,
    parameters: Sequence[Any],
    targets: dict[str, Target],
    known: Sequence[Known],
) -> None:
    begun = time.perf_counter()
    name_device(run.info, config.variant)
    run.progress.begin(["fit"])
    fitted = [targets[m.label] for m in config.measurement if m.role == "fit" and m.label in targets]

    def tell(stage: str, share: float) -> None:
        run.progress.advance("fit", min(share, 0.999), stage)
        if stage == "record":
            run.stop_if_asked()

    try:
        found = fit(
            forward,
            fitted,
            parameters,
            algorithm="auto" if config.search.algorithm == ("auto",) else config.search.algorithm,
            starts=config.search.starts,
            seed=config.seed,
            max_evaluations=config.search.max_evaluations,
            max_seconds=config.search.max_seconds,
            most_recordings=config.search.most_recordings,
            progress=tell,
            stopping=run.stopping.is_set,
        )
    except Interrupted:
        run.stop_if_asked()
        raise
    run.progress.advance("fit", 1.0)
    best = forward.answer(found.best)
    first = forward.answer(found.space.values(found.space.vector({})))
    for text in (*forward.stack(found.best).notes, *found.notes, *found.verdict.sentences):
        run.note(_named(text, config))
    result = _result(config, best, first, targets, found)
    run.write_result({"/": result})
    seconds = time.perf_counter() - begun
    scores = _scores(config, targets, best.value, first.value)
    run.write_table("fit.csv", INTERVALS, _intervals(config, found))
    run.write_table("scores.csv", SCORES, scores)
    run.write_table("correlation.csv", *_correlation(config, found))
    run.write_table("path.csv", *_path(config, found))
    if config.profiles:
        run.write_table("profiles.csv", *_profiles(config, forward, found, fitted))
    run.write_table("costs.csv", COSTS, _costs(config.reading.name, found, forward, best))
    run.write_table("recordings.csv", tuple(forward.recordings[0]), forward.recordings)
    reading = (config.reading,)
    run.write_table("tissue.csv", *tables.tissue(config.tissue.build(), reading))
    run.write_table(
        "provenance.csv", *tables.provenance(config.tissue.build(), reading, config.wavelengths.grid(), known)
    )
    if config.bench:
        run.write("bench.json", json.dumps(_bench(config, found, targets), separators=(",", ":"), allow_nan=False))
    claims = _claims(config, scores, found, {k.spec.label: k.reason for k in known}, seconds)
    run.write_claims(claims)
    run.info["claim_notes"] = {c.criterion: c.note for c in claims if c.note}


def _bench(config: FitExperiment, found: FitOutcome, targets: dict[str, Target]) -> dict[str, Any]:
    """The bench about the fitted tissue."""
    from livlab.acquire.bench import bench_data
    from livlab.model.tissue.tissue import override

    known = [
        {
            "label": label,
            "value": [float(v) if u and np.isfinite(v) else None for v, u in zip(t.data, t.use, strict=True)],
            "absolute": t.scaling == "none",
        }
        for label, t in targets.items()
    ]
    return bench_data(
        override(config.tissue.build(), found.best, by="fit"),
        config.reading,
        config.wavelengths.grid(),
        config.instrument,
        references=known,
        standard_error=GUIDE * config.search.standard_error,
        seed=config.seed,
    )


def _named(text: str, config: FitExperiment) -> str:
    """A sentence with labels in place of paths."""
    for path, label in config.labels().items():
        text = text.replace(path, label)
    return text


def _result(config: FitExperiment, best: Any, first: Any, targets: dict[str, Target], found: FitOutcome) -> xr.Dataset:
    grid = config.wavelengths.grid()
    dims = ("measurement", "wavelength")
    shape = (len(targets), len(grid))
    model, data, sigma, begun = (np.full(shape, np.nan) for _ in range(4))
    for k, target in enumerate(targets.values()):
        use = target.use
        model[k, use], data[k, use], sigma[k, use] = target.normalised(best.value)
        begun[k, use] = target.normalised(first.value)[0]
    one = {"units": "1"}
    return xr.Dataset(
        {
            "reflectance": ("wavelength", best.value, one),
            "reflectance_se": ("wavelength", best.standard_error, one),
            "reflectance_start": ("wavelength", first.value, one),
            "model": (dims, model, one),
            "model_start": (dims, begun, one),
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
        },
    )


def _intervals(config: FitExperiment, found: FitOutcome) -> list[dict[str, object]]:
    frame = found.intervals(config.level)
    rows: list[dict[str, object]] = []
    for p in config.parameter:
        row = frame.loc[p.path]
        own = found.space.by_name[p.path]
        rows.append(
            {
                "parameter": p.name,
                "path": p.path,
                "unit": p.unit,
                **{k: _number(row[k]) for k in ("value", "lower", "upper", "sd", "drift")},
                "status": str(row["status"]),
                "start": own.start_value,
                "low": p.low,
                "high": p.high,
            }
        )
    return rows


def _number(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _scores(
    config: FitExperiment, targets: dict[str, Target], best: FloatArray, first: FloatArray
) -> list[dict[str, object]]:
    grid = config.wavelengths.grid()
    rows: list[dict[str, object]] = []
    for m in config.measurement:
        if m.label not in targets:
            continue
        target = targets[m.label]
        now, before = target.scores(best), target.scores(first)
        used = grid[target.use]
        rows.append(
            {
                "measurement": m.label,
                "role": m.role,
                "points": target.size,
                "first_nm": float(used[0]),
                "last_nm": float(used[-1]),
                "rmse": _number(now["rmse"]),
                "pearson": _number(now["pearson"]),
                "rmse_start": _number(before["rmse"]),
                "pearson_start": _number(before["pearson"]),
            }
        )
    return rows


def _correlation(config: FitExperiment, found: FitOutcome) -> tuple[tuple[str, ...], list[dict[str, object]]]:
    labels = config.labels()
    frame = found.covariance.correlation.rename(index=labels, columns=labels)
    rows: list[dict[str, object]] = [
        {"parameter": str(name), **{str(k): _number(v) for k, v in row.items()}} for name, row in frame.iterrows()
    ]
    return ("parameter", *map(str, frame.columns)), rows


def _path(config: FitExperiment, found: FitOutcome) -> tuple[tuple[str, ...], list[dict[str, object]]]:
    frame = found.path.rename(columns=config.labels())
    columns = ("recording", *(str(c) for c in frame.columns if c != "recording"))
    return columns, [{str(k): v for k, v in row.items()} for row in frame[list(columns)].to_dict("records")]


def _profiles(
    config: FitExperiment, forward: LedgerForward, found: FitOutcome, targets: Sequence[Target]
) -> tuple[tuple[str, ...], list[dict[str, object]]]:
    """Profile-likelihood intervals, with the last recording's draws."""
    from livlab.optimise import profile
    from livlab.study.fit_problem import Problem

    problem = Problem(forward, targets, found.space, eager=True)
    problem.freeze_errors(found.best)
    rows: list[dict[str, object]] = []
    for p in found.space.free:
        made = profile(
            lambda v: 0.5 * float(np.sum(problem.residuals(v) ** 2)) / found.residual_scale,
            found.space,
            found.best,
            p.name,
            level=config.level,
            gradient=lambda v: {
                k: float(j @ problem.residuals(v)) / found.residual_scale for k, j in problem.jacobian(v).items()
            },
            max_evaluations=400,
        )
        rows.append(
            {
                "parameter": config.labels()[p.name],
                "lower": made.lower,
                "value": made.value,
                "upper": made.upper,
                "open_below": made.open_below,
                "open_above": made.open_above,
                "evaluations": made.evaluations,
            }
        )
    problem.release()
    return ("parameter", "lower", "value", "upper", "open_below", "open_above", "evaluations"), rows


def _costs(reading: str, found: FitOutcome, forward: LedgerForward, best: Any) -> list[dict[str, object]]:
    error, level = float(best.standard_error.max()), float(best.value.max())
    rows: list[dict[str, object]] = [
        {
            "stage": "measure",
            "seconds": r["seconds"],
            "samples": r["photons"],
            "samples_per_second": float(r["photons"]) / float(r["seconds"]),  # type: ignore[arg-type]
            "solver": "ledger",
            "error": error,
            "relative_error": error / max(level, 1e-300),
        }
        for r in forward.recordings
    ]
    rows += [{"stage": "search", "seconds": s.seconds, "evaluations": s.evaluations} for s in found.searches]
    rows.append({"stage": "uncertainty", "seconds": found.seconds["uncertainty"]})
    return [{"reading": reading, **row} for row in rows]


def _claims(
    config: FitExperiment,
    scores: Sequence[dict[str, object]],
    found: FitOutcome,
    reasons: dict[str, str],
    seconds: float,
) -> list[Claim]:
    by_label = {str(s["measurement"]): s for s in scores}
    claims = []
    for c in config.criterion:
        value: Any = float(found.settled) if c.of is None else by_label.get(c.of, {}).get(c.metric)
        if value is None:
            why = reasons.get(str(c.of)) or f"{c.metric} of {c.of} cannot be computed"
            claims.append(Claim.missing(c.name, why, reference=c.reference, tolerance=c.tolerance, seconds=seconds))
        else:
            claims.append(Claim.of(c.name, float(value), 0.0, c.reference, c.tolerance, seconds=seconds))
    return claims


__all__ = ["lab_of", "prepare"]
