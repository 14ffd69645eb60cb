"""Jobs that check livlab itself: the hard cases, and every solver on one scene."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from livlab.criteria import Claim
from livlab.errors import InputError
from livlab.kinds.checks.config import LadderExperiment, StressExperiment

if TYPE_CHECKING:
    from livlab.kinds.checks.cost import CostRow
    from livlab.model.tissue.stack import OpticalStack
    from livlab.runs.work import Run, Table
    from livlab.stress.catalogue import Case
    from livlab.stress.run import Line

SLOPE, SLOPE_TOLERANCE = -0.5, 0.25
"""A Monte Carlo error falls with the square root of the samples. Half-way to what else it could be: 0, a bias that no
sample mends, or −1."""


def prepare_stress(config: StressExperiment) -> Callable[[Run], None]:
    """The cases, then the job.

    Raises
    ------
    InputError
        No case is so named.
    """
    from livlab.stress.catalogue import select

    chosen = select(config.only, slow=config.slow)
    return lambda run: _stress(run, chosen)


def _stress(run: Run, chosen: Sequence[Case]) -> None:
    from livlab.stress.run import run_case, write_csv

    topics = list(dict.fromkeys(c.topic for c in chosen))
    run.progress.begin(topics)
    lines: list[Line] = []
    costs = []
    for topic in topics:
        own = [c for c in chosen if c.topic == topic]
        first = len(lines)
        for k, case in enumerate(own):
            lines += run_case(case)
            run.progress.advance(topic, (k + 1) / len(own), case.name)
            run.stop_if_asked()
        costs.append({"stage": topic, "seconds": sum(x.seconds for x in lines[first:])})
    write_csv(run.folder / "stress.csv", lines)
    run.keep("stress.csv")
    claims = case_claims(lines)
    what = {x.case: x.what for x in lines}
    about = {c.criterion: what[c.criterion.partition(": ")[2]] for c in claims}
    run.finish(claims, {}, (("stage", "seconds"), costs), about)


def case_claims(lines: Sequence[Line]) -> list[Claim]:
    """One claim a case: that none of its checks fails. One that could not be run is missing."""
    claims = []
    for case in dict.fromkeys(x.case for x in lines):
        own = [x for x in lines if x.case == case]
        name, seconds = f"checks that fail: {case}", sum(x.seconds for x in own)
        missing = next((x for x in own if x.verdict == "MISSING"), None)
        if missing is not None:
            why = missing.note or "it could not be run"
            claims.append(Claim.missing(name, why, reference=0.0, tolerance=0.0, seconds=seconds))
        else:
            failed = float(sum(x.verdict == "FAIL" for x in own))
            claims.append(Claim.of(name, failed, 0.0, 0.0, 0.0, seconds=seconds))
    return claims


def prepare_ladder(config: LadderExperiment) -> Callable[[Run], None]:
    """The scene, then the job."""
    from livlab.model.tissue.optics import optical_stack

    stack = optical_stack(config.tissue.build(), config.reading, config.wavelengths.grid())
    return lambda run: _ladder(run, config, stack)


def _ladder(run: Run, config: LadderExperiment, stack: OpticalStack) -> None:
    from livlab.kinds.checks.cost import COLUMNS, cost
    from livlab.kinds.shared import tissue_tables

    run.info |= {"variant": config.variant}
    run.progress.begin(["solvers"])

    def say(solver: str) -> None:
        run.stop_if_asked()
        run.progress.advance("solvers", 0.0, solver)

    started = time.perf_counter()
    rows = cost(
        stack,
        config.instrument,
        budget_seconds=config.budget_seconds,
        seed=config.seed,
        variant=config.variant,
        say=say,
    )
    run.progress.advance("solvers", 1.0)
    spent = time.perf_counter() - started
    name = config.reading.name
    tissue, grid = config.tissue.build(), config.wavelengths.grid()
    made: dict[str, Table] = {
        "cost.csv": (("reading", *COLUMNS), [{"reading": name, **asdict(r)} for r in rows]),
        "tissue.csv": tissue_tables.tissue(tissue, (config.reading,)),
        "provenance.csv": tissue_tables.provenance(tissue, (config.reading,), grid, ()),
    }
    costs = [{"stage": "every solver", "seconds": spent}]
    run.finish(ladder_claims(rows, config.within), made, (("stage", "seconds"), costs))


def ladder_claims(rows: Sequence[CostRow], within: float) -> list[Claim]:
    """What each solver says of its own error, against what was measured; and how a walk's error falls."""
    claims = []
    for solver in dict.fromkeys(r.solver for r in rows):
        own = [r for r in rows if r.solver == solver]
        seconds = sum(r.seconds * r.repeats for r in own)
        name = f"largest error over what it states: {solver}"
        told = [r for r in own if r.trusted and r.valid and math.isfinite(r.stated) and r.stated > 0]
        if told:
            worst = max(r.error / r.stated for r in told)
            claims.append(Claim.of(name, worst, 0.0, 0.0, within, seconds=seconds))
        else:
            why = "; ".join(dict.fromkeys(_why(r) for r in own))
            claims.append(Claim.missing(name, why, reference=0.0, tolerance=within, seconds=seconds))
    walks = dict.fromkeys(r.solver for r in rows if r.solver.startswith("walk"))
    return claims + [_slope(rows, solver) for solver in walks]


def _why(r: CostRow) -> str:
    if not r.valid:
        return "it does not hold here at every wavelength" + (f": {r.notes}" if r.notes else "")
    return "it is the reference, or no better a one is there to measure it" if not r.trusted else "it states none"


def _slope(rows: Sequence[CostRow], solver: str) -> Claim:
    from livlab.kinds.checks.cost import slope

    name = f"slope of ln error over ln samples: {solver}"
    try:
        value, error = slope(list(rows), solver)
    except InputError as trouble:
        return Claim.missing(name, trouble.message, reference=SLOPE, tolerance=SLOPE_TOLERANCE)
    return Claim.of(name, value, error, SLOPE, SLOPE_TOLERANCE, samples="repeats of its walks")


__all__ = ["case_claims", "ladder_claims", "prepare_ladder", "prepare_stress"]
