"""The search itself: starts, stages, limits; its end polished, tested and told."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from livlab.errors import InputError, Interrupted
from livlab.optimise.algorithms import Algorithm, choose
from livlab.optimise.convergence import examine
from livlab.optimise.guard import Callback, Gradient, Guard, Objective
from livlab.optimise.judge import does_nothing, sentences, settle_on_bounds
from livlab.optimise.parameters import ParameterSpace
from livlab.optimise.polish import Polisher, Residual
from livlab.optimise.result import Convergence, FitWarning, OptimiseResult, Polish
from livlab.optimise.stages import StageEnd, Tolerances, run_stage
from livlab.optimise.starts import finite_near, spread, starting_points
from livlab.units import FloatArray

EVALUATIONS_PER_PARAMETER = 500
GLOBAL_SHARE = 0.6
LOCAL_SHARE = 0.5

AFRESH = 30.0
"""Units of the parameters in such a round, over steps that change the objective as much as its test looked for."""

ROUNDS = 6
"""Times that a local search goes on, its units chosen anew, from an end that is no minimum."""


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """How a search goes; see `livlab.optimise.minimise`.

    Attributes
    ----------
    spare
        Further starts of a least-squares search whose end is no minimum or lies on a bound; with none, it is not gone
        over with smaller steps, either.
    """

    algorithm: str | tuple[str, ...] = "auto"
    starts: int | Sequence[Mapping[str, float]] = 1
    max_evaluations: int | None = None
    max_seconds: float = math.inf
    value_tolerance: float = 1e-12
    parameter_tolerance: float = 1e-8
    seed: int = 0
    callback: Callback | None = None
    one_sigma: float = 0.5
    warn: bool = True
    test: bool = True
    spare: int = 4

    def __post_init__(self) -> None:
        if self.max_evaluations is not None and self.max_evaluations < 1:
            raise InputError.of(
                "max_evaluations", self.max_evaluations, "must be at least 1", "Allow one evaluation or more."
            )
        if not self.max_seconds > 0:
            raise InputError.of("max_seconds", self.max_seconds, "must be > 0", "Allow some time.")
        if not (self.one_sigma > 0 and math.isfinite(self.one_sigma)):
            remedy = "Use 0.5 for a log-likelihood, 1 for chi-square."
            raise InputError.of("one_sigma", self.one_sigma, "must be > 0", remedy)

    @property
    def tolerances(self) -> Tolerances:
        """Where a stage ends."""
        return Tolerances(self.value_tolerance, self.parameter_tolerance)


def search(
    objective: Objective,
    space: ParameterSpace,
    options: SearchOptions,
    *,
    gradient: Gradient | None = None,
    residuals: Residual | None = None,
) -> OptimiseResult:
    """Minimise an objective; its end is polished where its residuals are known.

    Raises
    ------
    InputError, Interrupted
        As `livlab.optimise.minimise`.
    """
    free = len(space.free)
    points, notes = starting_points(space, options.starts, options.seed)
    guard = Guard(
        objective,
        gradient,
        space,
        one_sigma=options.one_sigma,
        max_evaluations=options.max_evaluations or EVALUATIONS_PER_PARAMETER * (free + 1) * len(points),
        max_seconds=options.max_seconds,
        callback=options.callback,
    )
    stages: tuple[Algorithm, ...] = ()
    if free:
        stages = choose(options.algorithm, free=free, gradient=gradient is not None, boxed=not space.finite_box())
    run = _Search(guard, options, tuple(points), stages, residuals)
    rows: list[dict[str, Any]] = []
    for number in range(len(points)):
        if guard.interrupted or guard.halted or (number and guard.spent()):
            break
        rows.append(run.one_start(number))
    result = run.result(rows, notes)
    if options.warn:
        for sentence in result.warnings:
            warnings.warn(sentence, FitWarning, stacklevel=3)
    return result


@dataclass(frozen=True, eq=False)
class _Search:
    """What is run: stages from each point, then the end."""

    guard: Guard
    options: SearchOptions
    points: tuple[FloatArray, ...]
    stages: tuple[Algorithm, ...]
    residuals: Residual | None

    def one_start(self, number: int) -> dict[str, Any]:
        """The stages from one point: where it ended, and how."""
        guard, point, seed = self.guard, self.points[number], self.options.seed + number
        before, x, end = guard.count, point, StageEnd("nothing was free to vary", True)
        guard.begin(number, "start", guard.max_evaluations)
        try:
            x = finite_near(guard, point, seed)
        except KeyboardInterrupt:
            guard.interrupted, end = True, StageEnd("interrupted by the user", False)
        stages = [s for s in self.stages if number == 0 or not s.is_global] or list(self.stages)
        found, value = x, guard.local
        for k, stage in enumerate(stages):
            if guard.interrupted or guard.halted:
                break
            left = guard.max_evaluations - guard.count
            alone = stage.is_global and k + 1 < len(stages)
            share = GLOBAL_SHARE if alone else self._local_share() / (len(self.points) - number)
            guard.begin(number, stage.name, guard.count + max(1, int(share * left)))
            end = run_stage(guard, stage, x, seed, self.options.tolerances)
            if guard.local_x is not None and guard.local <= value:
                x = found = guard.local_x
                value = guard.local
        if guard.broken is not None:
            raise guard.broken
        began = {f"start_{n}": v for n, v in guard.space.values(point).items() if n in guard.space.names}
        ended = {n: v for n, v in guard.space.values(found).items() if n in guard.space.names}
        return {
            "value": value,
            "evaluations": guard.count - before,
            "converged": end.by_tolerance and math.isfinite(value),
            "stop": end.words,
            **began,
            **ended,
        }

    def _local_share(self) -> float:
        """What local stages may use up, so that the polish has evaluations left."""
        return 1.0 if self.residuals is None else LOCAL_SHARE

    def result(self, rows: list[dict[str, Any]], notes: list[str]) -> OptimiseResult:
        """The best point of all starts, polished and tested, and what to mistrust about it."""
        guard, options = self.guard, self.options
        _best_point(guard)
        winner = min(range(len(rows)), key=lambda k: float(rows[k]["value"]))
        before, start = guard.count, guard.space.values(self.points[winner])
        polish, convergence, exact = self._ending(winner, rows[winner])
        best, space = _best_point(guard), guard.space
        status = space.status(best, space.vector(start), exact=exact)
        values, path = space.values(best), guard.path()
        idle = [n for n, word in status.items() if word.startswith("unchanged") and does_nothing(guard, best, n)]
        rows[winner] |= {k: v for k, v in values.items() if k in space.names}
        rows[winner] |= {"value": guard.best, "converged": convergence.converged}
        rows[winner]["evaluations"] += guard.count - before
        stop = self._stop(str(rows[winner]["stop"]), polish, convergence)
        starts = pd.DataFrame(rows)
        starts.index.name = "start"
        told = [stop] if options.test and space.free and not convergence else []
        return OptimiseResult(
            best=values,
            value=guard.best,
            status=status,
            evaluations=guard.count,
            failures=guard.failures,
            seconds=guard.seconds(),
            stop=stop,
            converged=convergence.converged,
            interrupted=guard.interrupted,
            path=path,
            starts=starts,
            warnings=(*notes, *told, *sentences(guard, space, status, values, path, idle, convergence)),
            algorithm=" + ".join(s.name for s in self.stages) or "none",
            seed=options.seed,
            one_sigma=options.one_sigma,
            convergence=convergence,
            polish=polish,
        )

    def _stop(self, stop: str, polish: Polish | None, convergence: Convergence) -> str:
        """Why it ended, what was polished, and why this is not called converged if so."""
        if self.guard.interrupted:
            return "interrupted by the user"
        words = stop if polish is None else f"{stop}; {polish}"
        if convergence or not self.options.test:
            return words
        why = "" if convergence.words in words else f": {convergence.words}"
        return f"{words}; stopped, not converged{why}"

    def _ending(self, winner: int, row: dict[str, Any]) -> tuple[Polish | None, Convergence, bool]:
        """Polish and test the best point; and whether the objective told it from bounds near by."""
        guard = self.guard
        if not guard.space.free:
            return None, Convergence(True, "nothing is free to vary", 0.0), False
        if guard.interrupted or guard.halted or guard.spent():
            return None, Convergence(False, str(row["stop"])), False
        if not self.options.test:
            return None, Convergence(False, "the end was not tested"), False
        guard.begin(winner, "polish" if self.residuals is not None else "test", guard.max_evaluations)
        try:
            if self.residuals is not None:
                polish, convergence = self._polished(self.residuals, winner)
            else:
                polish, convergence = None, self._tested(winner)
            exact = settle_on_bounds(guard, convergence.noise)
        except KeyboardInterrupt:
            guard.interrupted = True
            return None, Convergence(False, "interrupted by the user"), False
        if guard.broken is not None:
            raise guard.broken
        return polish, convergence, exact

    def _polished(self, residuals: Residual, winner: int) -> tuple[Polish | None, Convergence]:
        """Levenberg–Marquardt, also from the start unless a global search chose where to go."""
        local = not any(s.is_global for s in self.stages)
        start = self.points[winner] if local else None
        spare = spread(self.guard.space, self.options.spare, self.options.seed + 271) if self.options.spare else []
        return Polisher(self.guard, residuals, self._first()).run(start, spare)

    def _first(self) -> float:
        """The first finite value."""
        found = self.guard.path()["value"]
        return float(found[np.isfinite(found)].iloc[0])

    def _tested(self, winner: int) -> Convergence:
        """The test; a local search whose end is no minimum goes on from there, its units chosen anew."""
        guard, options = self.guard, self.options
        local = [s for s in self.stages if not s.is_global]
        for number in range(ROUNDS + 1):
            guard.begin(winner, "test", guard.max_evaluations)
            before = guard.best
            found = examine(guard, self._first(), options.one_sigma)
            loose = found.convergence.decrease <= 10.0 * options.value_tolerance * abs(guard.best)
            if found.convergence or not local or loose or number == ROUNDS or guard.over():
                break
            assert guard.best_x is not None
            guard.rescale(np.where(found.steps > 0, AFRESH * found.steps, 1.0), AFRESH**2 * found.rise)
            guard.begin(winner, local[-1].name, guard.max_evaluations)
            end = run_stage(guard, local[-1], guard.best_x, options.seed + number, options.tolerances)
            if guard.reason is not None:
                return replace(found.convergence, converged=False, words=end.words)
            if not guard.best < before and number:
                break
        return found.convergence


def _best_point(guard: Guard) -> FloatArray:
    """Where the least was seen.

    Raises
    ------
    Interrupted, InputError
        It was seen nowhere.
    """
    if guard.best_x is not None:
        return guard.best_x
    if guard.interrupted:
        raise Interrupted("The fit was stopped before any point had a finite value.", remedy="Run it again.")
    why = f"The first failure: {guard.first_error!r}. " if guard.first_error else ""
    raise InputError.of(
        "objective",
        f"no finite value in {guard.count} evaluations",
        "must be finite somewhere within the bounds",
        f"{why}Check the objective at the start, or move the bounds.",
    ) from guard.first_error
