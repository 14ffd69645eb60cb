"""The fit job: measured curves → targets → search with fresh draws → intervals, checks on unseen bands, claims."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.errors import InputError, Interrupted
from livlab.fitting.fit import GUIDE
from livlab.fitting.options import FitOptions
from livlab.fitting.outcome import FitOutcome
from livlab.kinds.fit import coverage as fit_coverage
from livlab.kinds.fit import tables
from livlab.kinds.fit.alternatives import MODELS, SPREAD, VALUES, Alternatives, OtherModel, models_of
from livlab.kinds.fit.config import FitExperiment, Measurement
from livlab.kinds.fit.round_trip import SEEDS, Trip, round_trip
from livlab.kinds.fit.setup import FitSetup, MeasuredCurve
from livlab.kinds.shared import tissue_tables
from livlab.kinds.shared.references import Known, load_reference
from livlab.kinds.shared.sections import Reference
from livlab.machine.gpu import name_device

if TYPE_CHECKING:
    from livlab.runs.work import Run, Table


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
    if not any(m.role == "fit" and k.dataset for m, k in zip(config.measurement, known, strict=True)):
        raise InputError.of(
            "measurement", "none available", known[0].reason or "has no numbers", "Add the data: livlab data add FILE."
        )
    there = [(m.label, k) for m, k in zip(config.measurement, known, strict=True) if k.dataset]
    curves = {label: MeasuredCurve.known(k, grid) for label, k in there}
    setup, models = FitSetup.of(config, curves), models_of(config, curves)
    return lambda run: _work(run, setup, models, known)


def _load(m: Measurement) -> Known:
    return load_reference(
        Reference(label=m.label, dataset=m.dataset, column=m.column, sd_column=m.sd_column, subjects=m.subjects)
    )


def _work(run: Run, setup: FitSetup, models: Mapping[str, OtherModel], known: Sequence[Known]) -> None:
    config, forward, targets = setup.config, setup.forward, setup.targets
    begun = time.perf_counter()
    name_device(run.info, config.variant)
    run.progress.begin(["fit", *(["alternatives"] if models else []), *(["round trips"] if config.round_trip else [])])

    def tell(stage: str, share: float) -> None:
        run.progress.advance("fit", min(share, 0.999), stage)
        if stage == "record":
            run.stop_if_asked()

    try:
        found = setup.search(progress=tell, stopping=run.stopping.is_set)
    except Interrupted:
        run.stop_if_asked()
        raise
    run.progress.advance("fit", 1.0)
    best, begin = setup.curves(found)
    for text in setup.said(found):
        run.note(text)
    run.info["misfit"] = tables.misfit_record(found)
    run.write_result({"/": tables.result(config, best, begin, targets, found)})
    scores = tables.scores(config, targets, best.value, begin)
    tissue, reading = config.tissue.build(), (config.reading,)
    made: dict[str, Table] = {
        "fit.csv": (tables.INTERVALS, tables.intervals(config, found)),
        "misfit.csv": (tables.MISFIT, tables.misfit(found)),
        "scores.csv": (tables.SCORES, scores),
        "correlation.csv": tables.correlation(config, found),
        "path.csv": tables.path(config, found),
        "recordings.csv": (tuple(forward.recordings[0]), tuple(forward.recordings)),
        "tissue.csv": tissue_tables.tissue(tissue, reading),
        "provenance.csv": tissue_tables.provenance(tissue, reading, config.wavelengths.grid(), known),
    }
    for name, (columns, rows) in made.items():  # round trips take long: what is known is there before them
        run.write_table(name, columns, rows)
    costs = tables.costs(config.reading.name, found, forward, best)
    if config.bench:
        run.write("bench.json", json.dumps(_bench(setup, found), separators=(",", ":"), allow_nan=False))
    if models:
        _alternatives(run, setup, models, found)
    trips = _round_trips(run, setup) if config.round_trip is not None else []
    checked: dict[str, Table] = {}
    if trips:
        checked["round_trip.csv"] = fit_coverage.by_parameter(trips, config.labels())
        checked["round_trips.csv"] = fit_coverage.by_tissue(trips, config.labels())
        for text in fit_coverage.sentences(trips, config.labels()):
            run.note(text)
    seconds = time.perf_counter() - begun
    reasons = {k.spec.label: k.reason for k in known}
    claims = tables.claims(config, scores, found, fit_coverage.overall(trips), reasons, seconds)
    run.finish(claims, checked, (tables.COSTS, costs))


def _alternatives(run: Run, setup: FitSetup, models: Mapping[str, OtherModel], own: FitOutcome) -> None:
    """The other models fitted, weighed and written."""
    names = list(models)

    def tell(name: str, share: float) -> None:
        run.progress.advance("alternatives", min((names.index(name) + share) / len(names), 0.999), name)

    try:
        made = Alternatives.fitted(setup, own, models, progress=tell, stopping=run.stopping.is_set)
    except Interrupted:
        run.stop_if_asked()
        raise
    run.progress.advance("alternatives", 1.0)
    run.write_table("alternatives.csv", MODELS, made.table())
    run.write_table("alternative_values.csv", VALUES, made.values())
    run.write_table("spread.csv", SPREAD, made.spread_table())
    for text in made.notes():
        run.note(text)


def _round_trips(run: Run, setup: FitSetup) -> list[Trip]:
    """Every tissue's own numbers depend on its number and the seed alone."""
    config, how = setup.config, setup.config.round_trip
    assert how is not None
    for scene in setup.forward.scenes:
        scene.standard_error = how.standard_error
    trips = []
    for number in range(how.tissues):
        run.stop_if_asked()
        run.progress.advance("round trips", number / how.tissues, f"tissue {number + 1}")
        trips.append(
            round_trip(
                setup.forward,
                setup.fitted,
                setup.space,
                FitOptions(
                    algorithm=setup.algorithm,
                    starts=config.search.starts,
                    seed=config.seed + (number + 1) * SEEDS,
                    most_recordings=2,
                    level=config.level,
                ),
                relative_sd=how.relative_sd,
                rng=np.random.default_rng([config.seed, number]),
                stopping=run.stopping.is_set,
            )
        )
    run.progress.advance("round trips", 1.0)
    return trips


def _bench(setup: FitSetup, found: FitOutcome) -> dict[str, Any]:
    """The bench about the fitted tissue of the first measurement, and the curves measured on it."""
    from livlab.kinds.spectral.bench import bench_data

    config = setup.config
    scene = config.scenes()[0]
    size = len(config.wavelengths.grid())
    known = [
        {
            "label": label,
            "value": [float(v) if u and np.isfinite(v) else None for v, u in zip(t.data[:size], t.use, strict=False)],
            "absolute": t.scaling == "none",
        }
        for label, t in setup.targets.items()
        if label in scene.labels
    ]
    return bench_data(
        setup.tissue(scene.labels[0], found.best),
        config.reading,
        config.wavelengths.grid(),
        config.instrument,
        references=known,
        standard_error=GUIDE * config.search.standard_error,
        seed=config.seed,
    )


__all__ = ["prepare"]
