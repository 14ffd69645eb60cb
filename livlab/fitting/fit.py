"""Tissue parameters from measured curves: the search, fresh draws, and what the data hold.

The forward model is a callable with common random numbers: between two recordings its answers are smooth, so that a
gradient search works; each recording is another draw, so that what the parameters owe to chance can be told.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from livlab.errors import InputError, Interrupted
from livlab.fitting.intervals import ProfileInterval, Profiler
from livlab.fitting.misfit import misfit_of, widening
from livlab.fitting.options import FitOptions
from livlab.fitting.outcome import FitOutcome
from livlab.fitting.problem import Problem, corners, is_tissue
from livlab.fitting.spread import ParameterSpread
from livlab.optimise import OptimiseResult, ParameterSpace, identifiability, least_squares
from livlab.optimise.covariance import normal_quantile
from livlab.optimise.misfit import Misfit

MORE = 2
"""Recordings beyond those, at most, made because intervals reach to where the last one cannot answer."""

SETTLED = 0.25
"""Share of its standard deviation that a parameter may move from one recording to the next."""

TINY = 1e-4
"""Share of its box below which a parameter's move is none, however well the data hold it."""

VALUE_TOLERANCE = 1e-6
"""Relative change of the loss at which a search ends: far below what another draw changes."""

GUIDE = 2.0
"""The first recording's standard error over the wanted one: it serves the whole box and only leads to the optimum."""

REACH = 0.15
"""Half the side of the box that later recordings serve, as a share of the whole one's."""

Values = Mapping[str, float]


def fit(
    problem: Problem,
    options: FitOptions | None = None,
    *,
    progress: Callable[[str, float], None] | None = None,
    stopping: Callable[[], bool] | None = None,
) -> FitOutcome:
    """Fit parameters to measured curves: record, search, record anew at the optimum, until fresh draws agree.

    Parameters
    ----------
    problem
        The forward model, the measured curves (the sum of their losses is minimised), and the parameters.
    options
        How it is sought; as `FitOptions` has it if not given.
    progress
        Called with a stage and its share done.
    stopping
        Asked after each evaluation whether the user wants to stop.

    Raises
    ------
    Interrupted
        The user wanted to stop.
    InputError
        No free parameter, or an objective that is finite nowhere.
    """
    space = problem.space
    if not space.free:
        raise InputError.of("parameter", space.names, "at least one must be free", "Give one low < high, not fixed.")
    chosen = options or FitOptions()
    problem.eager = chosen.by_gradient
    run = _Run(problem, chosen, progress or (lambda stage, share: None), stopping or (lambda: False))
    at = space.values(space.vector({}))
    run.record(at, 0)
    for number in range(chosen.most_recordings + MORE):
        at = run.search(at)
        run.judge(number)
        if run.profiled and (not run.lost or number + 1 >= chosen.most_recordings + MORE):
            break
        if run.profiled or number + 1 < chosen.most_recordings:
            run.record(at, number + 1)
    made = run.outcome()
    problem.release()
    return made


@dataclass
class _Run:
    """A fit on its way: what each recording gave."""

    problem: Problem
    options: FitOptions
    tell: Callable[[str, float], None]
    stopping: Callable[[], bool]
    begun: float = field(default_factory=time.perf_counter)
    seconds: dict[str, float] = field(default_factory=lambda: {"record": 0.0, "search": 0.0, "uncertainty": 0.0})
    searches: list[OptimiseResult] = field(default_factory=list)
    drift: dict[str, float] = field(default_factory=dict)
    moved: dict[str, float] = field(default_factory=dict)
    spread: ParameterSpread | None = None
    misfit: Misfit | None = None
    widened: float = 1.0
    settled: bool = False
    profiled: dict[str, ProfileInterval] = field(default_factory=dict)
    lost: list[dict[str, float]] = field(default_factory=list)
    served: list[Values] = field(default_factory=list)

    def record(self, values: Values, number: int) -> None:
        """A recording about these values: the whole box by the first, a small one about the optimum by later ones."""
        clock = time.perf_counter()
        problem, seed = self.problem, self.options.seed
        about: dict[str, Any] = {} if number == 0 else {"about": values, "reach": REACH}
        problem.forward.record(
            values,
            [*corners(problem.forward, problem.space, seed, **about), *self.served],
            seed=seed + 1000 * number,
            coarser=GUIDE if number == 0 else 1.0,
            progress=lambda s: self.tell("record", s),
        )
        problem.refresh()
        problem.freeze_errors(values)
        self.seconds["record"] += time.perf_counter() - clock

    def search(self, at: Values) -> dict[str, float]:
        """The optimum on the last recording, and how far it moved from that on the one before."""
        clock = time.perf_counter()
        options, space = self.options, self.problem.space
        first: dict[str, Any] = {"algorithm": options.algorithm, "starts": options.starts}
        found = least_squares(
            self.problem.residuals,
            space,
            jacobian=self.problem.jacobian,
            seed=options.seed,
            max_evaluations=options.max_evaluations,
            max_seconds=max(1.0, options.max_seconds - (time.perf_counter() - self.begun)),
            value_tolerance=VALUE_TOLERANCE,
            warn=False,
            callback=self._watch,
            # Later searches start from the optimum that the whole box's recording led to: no other valley is asked for.
            **({"starts": [at], "spare": 0} if self.searches else first),
        )
        self.seconds["search"] += time.perf_counter() - clock
        if found.interrupted or self.stopping():
            raise Interrupted("The fit was stopped.", remedy="Give the same command again.")
        self.searches.append(found)
        if self.searches[1:]:
            self.drift = {p.name: found.best[p.name] - at[p.name] for p in space.free}
            self.moved = dict(zip(space.names, space.vector(found.best) - space.vector(at), strict=True))
        return found.best

    def _watch(self, count: int, _values: Values, _value: float) -> bool:
        self.tell("search", min(0.99, count / (count + 20.0)))
        return not self.stopping()

    def judge(self, number: int) -> None:
        """Whether fresh draws agree with the last ones; and the intervals, if so or if it is time to end."""
        clock = time.perf_counter()
        problem, space, at = self.problem, self.problem.space, self.searches[-1].best
        spread = self.spread = ParameterSpread.of(problem, at)
        self.settled = bool(self.drift) and all(
            abs(self.moved[name]) <= TINY or _small(self.drift[name], spread.covariance.sd.get(name, math.inf))
            for name in space.names
        )
        if not number or self.settled or number + 1 >= self.options.most_recordings:
            self.tell("intervals", 0.0)
            self.misfit = misfit_of(problem, at, spread.plain.held)
            self.widened = widening(self.misfit, problem.by_residuals)
            profiler = Profiler(problem, space, at, spread.variance)
            rises = spread.rises((normal_quantile(self.options.level) * self.widened) ** 2 * spread.variance)
            told = {name: profiler.interval(name, rises[name]) for name in space.names}
            # The first recording serves the whole box: its intervals tell what the later ones have to serve.
            lost = [values for values in profiler.lost if is_tissue(problem.forward, values)]
            self.served += _farthest([*lost, *(profiler.ends if not number else ())], space, at)
            self.profiled = told if number else {}
            self.lost = lost
        self.seconds["uncertainty"] += time.perf_counter() - clock

    def outcome(self) -> FitOutcome:
        """The record of all this."""
        assert self.spread is not None
        assert self.misfit is not None
        last = self.searches[-1]
        wide = self.widened
        spread = self.spread if wide == 1.0 else ParameterSpread.of(self.problem, last.best, wide**2)
        return FitOutcome(
            best=last.best,
            space=self.problem.space,
            loss=2.0 * last.value,
            fresh_loss=self._fresh_loss(),
            searches=tuple(self.searches),
            drift=self.drift,
            settled=self.settled,
            covariance=spread.covariance,
            residual_scale=spread.variance,
            autocorrelation=spread.autocorrelation,
            misfit=self.misfit,
            widened=wide,
            by_residuals=self.problem.by_residuals,
            verdict=identifiability(self.spread.covariance),
            profiled=self.profiled,
            level=self.options.level,
            notes=tuple(self._notes()),
            seconds=self.seconds,
            path=pd.concat([s.path.assign(recording=k) for k, s in enumerate(self.searches)], ignore_index=True),
        )

    def _fresh_loss(self) -> float:
        """Σ r² that the last recording gave at the optimum of the one before: the draws did not shape that point."""
        if len(self.searches) < 2:
            return math.nan
        r = self.problem.residuals(self.searches[-2].best)
        return float(r @ r)

    def _notes(self) -> list[str]:
        """What a report must show."""
        problem, free = self.problem, len(self.problem.space.free)
        notes = list(dict.fromkeys(self.searches[-1].warnings))
        if not self.settled and self.drift:
            notes.append(
                f"After {len(self.searches)} recordings the optimum still moves by more than {SETTLED:g} of a standard "
                "deviation: ask for a smaller standard error of the forward model."
            )
        count = sum(t.independent for t in problem.targets)
        count += sum(p.prior_sd is not None for p in problem.space.parameters)
        if count <= free:
            why = "not all can be held" if count < free else "nothing is left over to tell the error from"
            notes.append(
                f"{free} parameters are free and {count} independent numbers are compared: {why}, and the "
                "intervals say nothing. Measure more wavelengths, or fit fewer parameters."
            )
        lost = [name for name, x in self.profiled.items() if x.spans]
        if lost:
            notes.append(f"The data do not bound {', '.join(lost)}: the interval reaches from bound to bound.")
        rough = [name for name, x in self.profiled.items() if x.rough]
        if rough:
            notes.append(
                f"The interval of {', '.join(rough)} is rough: the search for its ends, or the recorded walk, gave out "
                "there."
            )
        return notes


def _farthest(lost: Sequence[Values], space: ParameterSpace, at: Values) -> list[Values]:
    """The points farthest along each way, which a recording that serves them serves the others on the way too."""
    middle = space.vector(at)
    ways: dict[tuple[int, bool], tuple[float, Values]] = {}
    for values in lost:
        off = space.vector(values) - middle
        k = int(np.argmax(np.abs(off)))
        key = (k, bool(off[k] > 0))
        if key not in ways or abs(off[k]) > ways[key][0]:
            ways[key] = (abs(float(off[k])), values)
    return [values for _, values in ways.values()]


def _small(change: float, sd: float) -> bool:
    return abs(change) <= SETTLED * sd or not math.isfinite(sd)
