"""The study job: points or cases → jobs → curves → outputs → indices, tables and claims."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from livlab.config.errors import nearest
from livlab.criteria import Claim
from livlab.errors import InputError, Interrupted
from livlab.jobs.jobs import Answer, Job, Scheduler, run_jobs
from livlab.kinds.study import ablation, idle, sensitivity, sweep, tables
from livlab.kinds.study.config import StudyExperiment
from livlab.kinds.study.config_parts import StudyCriterion
from livlab.kinds.study.design import Design, laid_out
from livlab.kinds.study.outputs import Number, Outputs
from livlab.kinds.study.points import Base

if TYPE_CHECKING:
    import pandas as pd

    from livlab.runs.work import Run, Table
    from livlab.units import FloatArray

MOST_BOOTSTRAPPED = 500
"""Curves whose outputs get an error of their own; a sweep of more has its spread to show."""


def prepare(config: StudyExperiment) -> Callable[[Run], None]:
    """Everything that can go wrong before light is followed: references, bands, points, cases, their number.

    Raises
    ------
    InputError
        A reference shorter than a band, one point alone, more evaluations than `most_jobs`, a claim on no case, points
        of which none is a tissue (of a sensitivity: too few).
    DatasetError, RangeError
        A dataset that is damaged, or does not reach.
    """
    from livlab.runs.identity import dataset_hashes

    grid = config.wavelengths.grid()
    outputs = Outputs(config.output, config.reference, grid, config.normalise, config.seed)
    hashes = dataset_hashes(config.datasets())
    if config.method == "ablation":
        cases = ablation.cases(config)
        sweep.check_size(len(cases), config.most_jobs, "cases", "Name fewer options")
        labels = [c.label for c in cases]
        for k, c in enumerate(config.criterion):
            if c.of not in labels:
                more = f" and {len(labels) - 6} more" if len(labels) > 6 else ""
                hint = nearest(str(c.of), labels) or f"Known: {'; '.join(labels[:6])}{more}."
                raise InputError.of(f"criterion[{k}].of", c.of, "names no case", hint)
        return lambda run: _ablation(run, config, cases, outputs, hashes)
    if config.method == "sensitivity":
        assert config.sensitivity is not None
        size = config.sensitivity.jobs(len(config.factor))
        sweep.check_size(size, config.most_jobs, config.sensitivity.estimator, "Take fewer points or factors")
        unit = sensitivity.unit_design(config.sensitivity, len(config.factor), config.seed)
        design = laid_out(config, sweep.mapped(config.factor, unit))
        sensitivity.check_blocks(config.sensitivity, len(config.factor), design.empty)
        return lambda run: _sensitivity(run, config, unit, design, outputs, hashes)
    laid = laid_out(config, sweep.sweep_points(config), idle.probes(config))
    return lambda run: _sweep(run, config, laid, outputs, hashes)


def answers(run: Run, config: StudyExperiment, jobs: Sequence[Job], scheduler: Scheduler | None = None) -> list[Answer]:
    """What the jobs answer, kept in the run's folder as each ends; by the run's own scheduler if none is given.

    Raises
    ------
    Interrupted
        The user wanted to stop.
    EnvironmentProblem
        The machines cannot do some jobs; all others are kept.
    """
    from livlab.jobs.scheduler import open_scheduler
    from livlab.jobs.store import store_of

    if config.solver.kind != "adding-doubling":
        run.info["variant"] = config.variant
        if config.variant == "llvm" and not run.scheduler.startswith("tcp:"):
            from livlab.machine.llvm import choose_libllvm

            run.info["libllvm"] = choose_libllvm().name
    run.info["scheduler"] = run.scheduler
    run.progress.begin([config.method])
    store = store_of(run)
    scheduler = scheduler or open_scheduler(run.scheduler, run.progress.say)

    def tell(done: int, total: int) -> None:
        run.progress.advance(config.method, min(done / max(total, 1), 0.999), f"{done} of {total}")

    try:
        found = run_jobs(jobs, scheduler, store, tell, run.stopping.is_set)
    except Interrupted:
        run.stop_if_asked()
        raise
    finally:
        for text in store.notes:
            run.note(text)
    run.progress.advance(config.method, 1.0)
    return found


@dataclass(frozen=True)
class _Evaluated:
    """Curves and outputs of a design's points, what they cost, and how much each factor moves each output."""

    curves: list[Answer]
    made: list[dict[str, Number]]
    costs: list[dict[str, object]]
    moves: dict[str, list[idle.Move]]


def _evaluated(
    run: Run, config: StudyExperiment, design: Design, outputs: Outputs, hashes: Mapping[str, str]
) -> _Evaluated:
    """The points of a design; failed ones have nan and their reason."""
    begun = time.perf_counter()
    if design.empty:
        run.note(design.note())
    good = [*design.tissues(), *design.beside]
    given = answers(run, config, sweep.jobs_of(config, good, hashes))
    found = sweep.curves_of(config, good, given)
    curves, beside = design.whole(found[: len(good) - len(design.beside)]), found[len(good) - len(design.beside) :]
    wall = time.perf_counter() - begun
    made, apart = _numbers(config, curves, outputs), _numbers(config, beside, outputs)
    _tell_failures(run, curves, made, outputs, set(design.empty))
    metrics = {o.name: o.metric for o in config.output}
    moved = idle.moves(config.factor, metrics, [*design.points, *design.beside], [*made, *apart])
    if _noisy(config) and len(curves) > MOST_BOOTSTRAPPED:
        moved = {}  # nobody knows the outputs' errors
    for text in idle.idle(config, moved).values():
        run.note(text)
    return _Evaluated(curves, made, tables.costs(config, given, [*curves, *beside], wall), moved)


def _noisy(config: StudyExperiment) -> bool:
    return config.solver.kind in ("walk", "auto")


def _numbers(config: StudyExperiment, curves: Sequence[Answer], outputs: Outputs) -> list[dict[str, Number]]:
    noisy = _noisy(config) and len(curves) <= MOST_BOOTSTRAPPED
    made = []
    for c in curves:
        if "error" in c:
            made.append({name: Number(np.nan, np.nan, str(c["error"])) for name in outputs.names})
        else:
            made.append(outputs.numbers(np.array(c["value"]), np.array(c["standard_error"]) if noisy else None))
    return made


def _tell_failures(
    run: Run,
    curves: Sequence[Answer],
    made: Sequence[Mapping[str, Number]],
    outputs: Outputs,
    told: Collection[int] = (),
) -> None:
    """Notes on points without a curve, `told` being those noted already; on outputs that are nan or doubtful."""
    failed = [str(c["error"]) for k, c in enumerate(curves) if "error" in c and k not in told]
    if len(failed) == len(curves) - len(told):
        raise InputError.of(
            "study", f"0 of {len(failed)} evaluations", f"gave a curve; the first failed so: {failed[0]}",
            "Mend the tissue, or the factors' bounds.",
        )  # fmt: skip
    for text in outputs.doubts([np.array(c["value"]) for c in curves if "error" not in c]):
        run.note(text)
    if failed:
        run.note(
            f"{len(failed)} of {len(curves) - len(told)} evaluations gave no curve; the first failed so: {failed[0]}"
        )
    for name in outputs.names:
        if name in outputs.missing:
            run.note(f"{name}: {outputs.missing[name]}")
            continue
        reasons = [m[name].reason for m, c in zip(made, curves, strict=True) if "error" not in c]
        bad = [r for m, r in zip(made, reasons, strict=False) if r and not np.isfinite(m[name].value)]
        if bad:
            run.note(f"{name}: {len(bad)} of {len(reasons)} curves have none; the first because {bad[0]}")


def _sweep(run: Run, config: StudyExperiment, design: Design, outputs: Outputs, hashes: Mapping[str, str]) -> None:
    begun, points = time.perf_counter(), design.points
    found = _evaluated(run, config, design, outputs, hashes)
    curves, made = found.curves, found.made
    run.write_result({"/": tables.result(config, points, curves, made, outputs)})
    claims = []
    seconds = time.perf_counter() - begun
    for c in config.criterion:
        values = _column(made, c.output)
        values = values[np.isfinite(values)]
        value = None if not len(values) else float(values.min() if c.statistic == "least" else values.max())
        claims.append(_claim(config, c, value, 0.0, outputs.missing.get(c.output, "no point has a value"), seconds))
    written: dict[str, Table] = {"results.csv": tables.results(config, points, curves, made)}
    _finish(run, config, outputs, claims, written, found.costs, found.moves)


def _sensitivity(
    run: Run,
    config: StudyExperiment,
    unit: FloatArray,
    design: Design,
    outputs: Outputs,
    hashes: Mapping[str, str],
) -> None:
    assert config.sensitivity is not None
    begun, points = time.perf_counter(), design.points
    found = _evaluated(run, config, design, outputs, hashes)
    curves, made = found.curves, found.made
    run.write_result({"/": tables.result(config, points, curves, made, outputs)})
    names = [f.name for f in config.factor]
    grown: dict[str, pd.DataFrame] = {}
    why: dict[str, str] = dict(outputs.missing)
    for name in outputs.names:
        if name in why:
            continue
        try:
            grown[name] = sensitivity.growth(config.sensitivity, unit, _column(made, name), names, config.seed)
        except InputError as error:
            why[name] = error.message.replace("output = ", f"{name}: ", 1)
            run.note(f"Undefined indices: {why[name]}")
    written: dict[str, Table] = {
        "results.csv": tables.results(config, points, curves, made),
        "indices.csv": tables.indices(grown),
        "settling.csv": tables.settling(config.sensitivity, grown, why),
    }
    seconds = time.perf_counter() - begun
    claims = []
    for c in config.criterion:
        value = None
        if c.output in grown:
            frame = grown[c.output]
            if c.statistic == "widest interval":
                value = sensitivity.settled(config.sensitivity, frame)[0]
            else:
                column = c.statistic.replace(" ", "_")
                last = frame[frame["points"] == frame["points"].max()].set_index("factor")
                value = float(last[column][c.of]) if column in last else None
        reason = why.get(c.output, f"{config.sensitivity.estimator} gives no {c.statistic}")
        claims.append(_claim(config, c, value, 0.0, reason, seconds))
    _finish(run, config, outputs, claims, written, found.costs, found.moves)


def _ablation(
    run: Run,
    config: StudyExperiment,
    cases: Sequence[ablation.AblationCase],
    outputs: Outputs,
    hashes: Mapping[str, str],
) -> None:
    begun = time.perf_counter()
    base = Base(config.tissue.build(), config.reading, config.instrument)
    own = [c for c in cases if not c.same_as]
    jobs = [
        sweep.spectrum_job(
            config, Base(base.tissue, c.reading, base.instrument), {}, hashes, key=c.label, without=c.without
        )
        for c in own
    ]
    given = dict(zip([c.label for c in own], answers(run, config, jobs), strict=True))
    wall = time.perf_counter() - begun
    curves = [given[c.same_as or c.label] for c in cases]
    made = _numbers(config, curves, outputs)
    _tell_failures(run, curves, made, outputs)
    for text in (*tables.shared_notes(own, given), *tables.idle_notes(config, cases, made)):
        run.note(text)
    points: list[sweep.Point] = [{} for _ in cases]
    labels = [c.label for c in cases]
    run.write_result({"/": tables.result(config, points, curves, made, outputs, labels)})
    written: dict[str, Table] = {"ablation.csv": tables.ablation(config, cases, curves, made)}
    assert config.ablation is not None
    if config.ablation.target:
        written["targets.csv"] = tables.targets(config.ablation.target)
    written["results.csv"] = tables.results(config, points, curves, made, labels)
    claims = []
    for c in config.criterion:
        number = made[labels.index(str(c.of))][c.output]
        seconds = float(curves[labels.index(str(c.of))]["seconds"])
        claims.append(_claim(config, c, number.value, number.standard_error, number.reason, seconds))
    costs = tables.costs(config, list(given.values()), list(given.values()), wall)
    _finish(run, config, outputs, claims, written, costs)


def _column(made: Sequence[Mapping[str, Number]], name: str) -> FloatArray:
    return np.array([m[name].value for m in made], dtype=np.float64)


def _claim(
    config: StudyExperiment, c: StudyCriterion, value: float | None, error: float, reason: str, seconds: float
) -> Claim:
    if value is None or not np.isfinite(value) or not np.isfinite(error):
        why = reason or "its error cannot be had"
        return Claim.missing(c.name, why, aim=c.aim(config.output), seconds=seconds)
    return Claim.judged(c.name, value, error, c.aim(config.output), seconds=seconds)


def _finish(
    run: Run,
    config: StudyExperiment,
    outputs: Outputs,
    claims: Sequence[Claim],
    written: dict[str, Table],
    costs: list[dict[str, object]],
    moves: Mapping[str, Sequence[idle.Move]] | None = None,
) -> None:
    from livlab.kinds.shared import tissue_tables

    tissue, reading = config.tissue.build(), (config.reading,)
    written |= {
        "factors.csv": tables.factors(config, moves or {}),
        "tissue.csv": tissue_tables.tissue(tissue, reading),
        "provenance.csv": tissue_tables.provenance(tissue, reading, config.wavelengths.grid(), outputs.known),
    }
    run.finish(claims, written, (tables.COSTS, costs))


__all__ = ["answers", "prepare"]
