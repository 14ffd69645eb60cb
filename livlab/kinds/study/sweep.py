"""Sweeps: the points of a grid or of a low-discrepancy design, and the jobs that answer for them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from livlab.errors import InputError, LivlabError
from livlab.jobs.jobs import Answer, Job
from livlab.kinds.study.config import StudyExperiment
from livlab.kinds.study.config_parts import Factor, LedgerSolver
from livlab.kinds.study.points import Base
from livlab.units import FloatArray

BATCH = 128
"""Points that one ledger job answers."""

CORNERS = 8
"""Corners of the box that a recorded walk is to serve."""

Point = dict[str, Any]
"""Value by path."""


def sweep_points(config: StudyExperiment) -> list[Point]:
    """The points of a sweep.

    Raises
    ------
    InputError
        One point, where nothing varies; or more than `most_jobs`.
    """
    assert config.sweep is not None
    if config.sweep.design == "grid":
        grids = [f.grid() for f in config.factor]
        size = int(np.prod([len(g) for g in grids], dtype=object))
        shape = " × ".join(str(len(g)) for g in grids)
        check_size(size, config.most_jobs, f"a grid of {shape}", "Take fewer values, or design = 'latin-hypercube'")
        paths = [f.path for f in config.factor]
        made = [dict(zip(paths, p, strict=True)) for p in itertools.product(*grids)]
        if len(made) == 1:
            raise InputError.of("factor", shape, "makes one point: nothing varies", "Give a factor two values or more.")
        return made
    check_size(config.sweep.points, config.most_jobs, config.sweep.design, "Take fewer points")
    return mapped(config.factor, unit_points(config.sweep.design, len(config.factor), config.sweep.points, config.seed))


def check_size(size: int, most: int, what: str, remedy: str) -> None:
    """Refuse a study that is too large.

    Raises
    ------
    InputError
        It is.
    """
    if size > most:
        raise InputError.of(
            "study",
            f"{size} evaluations ({what})",
            f"is more than most_jobs = {most}",
            f"{remedy}, or raise most_jobs.",
        )


def unit_points(design: str, dimensions: int, count: int, seed: int) -> FloatArray:
    """(count, dimensions) points in the unit cube (`scipy.stats.qmc`).

    Parameters
    ----------
    design
        "sobol" (scrambled; a count that is no power of 2 is the beginning of one that is) or "latin-hypercube".

    Examples
    --------
    >>> u = unit_points("latin-hypercube", 2, 4, seed=1)
    >>> sorted((4 * u[:, 0]).astype(int).tolist())
    [0, 1, 2, 3]
    """
    from scipy.stats import qmc

    if design == "sobol":
        engine = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed))
        return np.asarray(engine.random_base2(max(1, (count - 1).bit_length()))[:count], dtype=np.float64)
    return np.asarray(qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(count), dtype=np.float64)


def mapped(factors: Sequence[Factor], unit: FloatArray) -> list[Point]:
    """Points of the unit cube as values by path."""
    return [{f.path: f.at(float(u)) for f, u in zip(factors, row, strict=True)} for row in unit]


def jobs_of(config: StudyExperiment, points: Sequence[Point], datasets: Mapping[str, str]) -> list[Job]:
    """The jobs that answer for points, in the order in which `curves_of` takes their answers.

    Parameters
    ----------
    config
        The study.
    points
        Value by path.
    datasets
        Hash of every dataset, which is part of what decides an answer.
    """
    if isinstance(config.solver, LedgerSolver):
        return [job for job, _ in _ledger_jobs(config, points, datasets)]
    base = Base(config.tissue.build(), config.reading, config.instrument)
    return [spectrum_job(config, base, point, datasets, key=str(k)) for k, point in enumerate(points)]


def curves_of(config: StudyExperiment, points: Sequence[Point], answers: Sequence[Answer]) -> list[Answer]:
    """The curve of each point from the jobs' answers."""
    if not isinstance(config.solver, LedgerSolver):
        return list(answers)
    made: list[Answer] = [{} for _ in points]
    for (_, members), answer in zip(_ledger_jobs(config, points, {}), answers, strict=True):
        for k, curve in zip(members, answer["curves"], strict=True):
            made[k] = curve
    return made


def spectrum_job(
    config: StudyExperiment,
    base: Base,
    point: Point,
    datasets: Mapping[str, str],
    *,
    key: str,
    without: Sequence[str] = (),
) -> Job:
    """The job of one curve; a walk's seed follows from the experiment's and from `key`."""
    from livlab.kinds.shared.seeds import reading_seed

    head = {p: v for p, v in point.items() if p.partition(".")[0] in ("reading", "instrument")}
    made = base.at(head)
    assert not isinstance(config.solver, LedgerSolver)
    solver = config.solver.with_seed(reading_seed(config.seed, key))
    payload = {
        "tissue": base.tissue.model_dump(mode="json"),
        "changes": {p: v for p, v in point.items() if p not in head},
        "reading": made.reading.model_dump(mode="json"),
        "wavelengths_nm": [float(x) for x in config.wavelengths.grid()],
        "instrument": made.instrument.model_dump(mode="json"),
        "solver": solver.model_dump(mode="json", exclude_none=True),
        "variant": config.variant,
        "without": list(without),
        "datasets": dict(sorted(datasets.items())),
    }
    return Job("spectrum", payload)


def _ledger_jobs(
    config: StudyExperiment, points: Sequence[Point], datasets: Mapping[str, str]
) -> list[tuple[Job, list[int]]]:
    """Batches of points that share everything but the tissue's numbers, and which points they are."""
    assert isinstance(config.solver, LedgerSolver)
    moving = [
        f for f in config.factor if not f.categorical and f.path.partition(".")[0] not in ("reading", "instrument")
    ]
    names = [f.path for f in moving]
    groups: dict[str, list[int]] = {}
    for k, point in enumerate(points):
        groups.setdefault(repr({p: v for p, v in point.items() if p not in names}), []).append(k)
    base = Base(config.tissue.build(), config.reading, config.instrument)
    made: list[tuple[Job, list[int]]] = []
    for members in groups.values():
        fixed = base.at({p: v for p, v in points[members[0]].items() if p not in names})
        recipe = {
            "tissue": fixed.tissue.model_dump(mode="json"),
            "reading": fixed.reading.model_dump(mode="json"),
            "wavelengths_nm": [float(x) for x in config.wavelengths.grid()],
            "instrument": fixed.instrument.model_dump(mode="json"),
            "variant": config.variant,
            "names": names,
            "centre": _centre(moving, fixed, [points[k] for k in members]),
            "others": _corners(moving, fixed, config.seed),
            "standard_error": config.solver.standard_error,
            "seed": config.seed,
            "datasets": dict(sorted(datasets.items())),
        }
        for start in range(0, len(members), BATCH):
            part = members[start : start + BATCH]
            made.append((Job("ledger", {**recipe, "points": [[points[k][n] for n in names] for k in part]}), part))
    return made


def _centre(moving: Sequence[Factor], base: Base, points: Sequence[Point]) -> list[float]:
    """The middle of the box; where that is no tissue, the point of the study that is nearest to it."""
    middle = [float(f.at(0.5)) for f in moving]
    try:
        base.at({f.path: x for f, x in zip(moving, middle, strict=True)})
    except LivlabError:
        span = np.array([f.at(1.0) - f.at(0.0) for f in moving])
        at = np.array([[float(p[f.path]) for f in moving] for p in points])
        return [float(x) for x in at[np.argmin(np.abs((at - middle) / span).max(axis=1))]]
    return middle


def _corners(moving: Sequence[Factor], base: Base, seed: int) -> list[list[float]]:
    """Corners of the box at which the tissue holds together, both ends first, the others by chance."""
    if not moving:
        return []
    sides = np.random.default_rng(seed).random((8 * CORNERS, len(moving))) < 0.5
    sides[0], sides[1] = False, True
    found: list[list[float]] = []
    for row in np.unique(sides, axis=0) if len(moving) < 4 else sides:
        corner = [float(f.at(1.0 if high else 0.0)) for f, high in zip(moving, row, strict=True)]
        try:
            base.at({f.path: x for f, x in zip(moving, corner, strict=True)})
        except LivlabError:
            continue
        if corner not in found:
            found.append(corner)
        if len(found) == CORNERS:
            break
    return found
