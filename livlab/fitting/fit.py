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
from livlab.fitting.intervals import Interval, Profiler
from livlab.fitting.problem import Forward, Problem, corners
from livlab.fitting.targets import Target
from livlab.optimise import (
    Covariance,
    Identifiability,
    OptimiseResult,
    Parameter,
    ParameterSpace,
    covariance_of_residuals,
    identifiability,
    least_squares,
)
from livlab.optimise.covariance import normal_quantile
from livlab.units import FloatArray

MOST_RECORDINGS = 5
"""Recordings after which a search that still moves is told as not settled."""

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


@dataclass(frozen=True, eq=False)
class FitOutcome:
    """A finished fit.

    Attributes
    ----------
    best, space
        Every parameter's value by name, and the parameters.
    searches
        One result a recording, the last one first in trust.
    drift
        Change of each free parameter from the last recording but one to the last: what it owes to chance.
    covariance
        At the optimum, of the residuals; scaled by `residual_scale`.
    residual_scale
        Factor on the covariance: 1 where every σ is known (chi2), else what the residuals themselves show.
    autocorrelation
        Of neighbouring residuals; their scale counts fewer points where it is high.
    verdict
        What the data do not hold.
    settled
        Whether fresh draws moved no parameter by more than a share of its standard deviation.
    loss, fresh_loss
        Σ r² at the optimum, with the draws of the search and with fresh ones.
    profiled
        Profile-likelihood interval of each free parameter at `level`, also of those at a bound.
    level
        Coverage that the intervals claim.
    notes
        Sentences that a report must show.
    seconds
        By stage.
    """

    best: dict[str, float]
    space: ParameterSpace
    searches: tuple[OptimiseResult, ...]
    drift: dict[str, float]
    covariance: Covariance
    residual_scale: float
    autocorrelation: float
    verdict: Identifiability
    settled: bool
    loss: float
    fresh_loss: float
    profiled: Mapping[str, Interval]
    level: float
    notes: tuple[str, ...]
    seconds: Mapping[str, float]
    path: pd.DataFrame = field(repr=False)

    def intervals(self) -> pd.DataFrame:
        """Lower, value, upper (profile likelihood), sd, status, open, drift by parameter; fixed ones have no interval.

        `open` says which ends are bounds that the data do not exclude: "", "below", "above" or "both".
        """
        rows = {}
        for name, value in self.best.items():
            p = self.space.by_name[name]
            found, factor = self.profiled.get(p.tied or name), p.factor if p.tied else 1.0
            ends = sorted((factor * found.lower, factor * found.upper)) if found is not None else [math.nan, math.nan]
            sides = (found.open_below, found.open_above) if found is not None else (False, False)
            rows[name] = {
                "lower": ends[0],
                "value": value,
                "upper": ends[1],
                "sd": self.covariance.sd.get(name, math.nan),
                "status": self.searches[-1].status[name],
                "drift": self.drift.get(name, math.nan),
                "open": _OPEN[sides[::-1] if factor < 0 else sides],
            }
        made = pd.DataFrame.from_dict(rows, orient="index")
        made.index.name = "parameter"
        return made


_OPEN = {(False, False): "", (True, False): "below", (False, True): "above", (True, True): "both"}


def fit(
    forward: Forward,
    targets: Sequence[Target],
    parameters: Sequence[Parameter] | ParameterSpace,
    *,
    algorithm: str | tuple[str, ...] = "auto",
    starts: int = 1,
    seed: int = 1,
    max_evaluations: int | None = None,
    max_seconds: float = math.inf,
    most_recordings: int = MOST_RECORDINGS,
    level: float = 0.95,
    progress: Callable[[str, float], None] | None = None,
    stopping: Callable[[], bool] | None = None,
) -> FitOutcome:
    """Fit parameters to measured curves: record, search, record anew at the optimum, until fresh draws agree.

    Parameters
    ----------
    forward
        The forward model.
    targets
        Measured curves; the sum of their losses is minimised.
    parameters
        With bounds.
    algorithm, starts, max_evaluations, max_seconds
        As `livlab.optimise.minimise`, for the first search; later ones start from its optimum.
    seed
        Of the first recording; each later one has another.
    most_recordings
        Recordings, two at least, after which it ends unsettled.
    level
        Coverage of the intervals.
    progress
        Called with a stage and its share done.
    stopping
        Asked after each evaluation whether the user wants to stop.

    Raises
    ------
    Interrupted
        The user wanted to stop.
    InputError
        No target, no free parameter, or an objective that is finite nowhere.
    """
    space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
    if not space.free:
        raise InputError.of("parameter", space.names, "at least one must be free", "Give one low < high, not fixed.")
    stages = (algorithm,) if isinstance(algorithm, str) else tuple(algorithm)
    problem = Problem(forward, targets, space, eager=all(a == "auto" or a.startswith("LD_") for a in stages))
    tell = progress or (lambda stage, share: None)
    seconds: dict[str, float] = {"record": 0.0, "search": 0.0, "uncertainty": 0.0}
    notes: list[str] = []
    begun = time.perf_counter()

    def record(values: Mapping[str, float], number: int, more: Sequence[Mapping[str, float]] = ()) -> None:
        clock = time.perf_counter()
        about = {} if number == 0 else {"about": values, "reach": REACH}
        forward.record(
            values,
            [*corners(forward, space, seed, **about), *more],  # type: ignore[arg-type]
            seed=seed + 1000 * number,
            coarser=GUIDE if number == 0 else 1.0,
            progress=lambda s: tell("record", s),
        )
        problem.refresh()
        problem.freeze_errors(values)
        seconds["record"] += time.perf_counter() - clock

    def watch(count: int, _values: Mapping[str, float], _value: float) -> bool:
        tell("search", min(0.99, count / (count + 20.0)))
        return not (stopping is not None and stopping())

    at = space.values(space.vector({}))
    record(at, 0)
    searches: list[OptimiseResult] = []
    losses: list[float] = []
    drift: dict[str, float] = {}
    moved: dict[str, float] = {}
    settled = False
    spread: Covariance | None = None
    scale = correlation = math.nan
    profiled: dict[str, Interval] = {}
    served: list[Mapping[str, float]] = []
    for number in range(most_recordings + MORE):
        clock = time.perf_counter()
        options: dict[str, Any] = {"algorithm": algorithm, "starts": starts} if not searches else {"starts": [at]}
        found = least_squares(
            problem.residuals,
            space,
            jacobian=problem.jacobian,
            seed=seed,
            max_evaluations=max_evaluations,
            max_seconds=max(1.0, max_seconds - (time.perf_counter() - begun)),
            value_tolerance=VALUE_TOLERANCE,
            warn=False,
            callback=watch,
            **options,
        )
        seconds["search"] += time.perf_counter() - clock
        if found.interrupted or (stopping is not None and stopping()):
            raise Interrupted("The fit was stopped.", remedy="Give the same command again.")
        searches.append(found)
        if searches[1:]:
            drift = {p.name: found.best[p.name] - at[p.name] for p in space.free}
            moved = dict(zip(space.names, space.vector(found.best) - space.vector(at), strict=True))
        at = found.best
        losses.append(2.0 * found.value)
        clock = time.perf_counter()
        scale, correlation = _scale(problem, at, space)
        slopes = problem.jacobian(at)
        plain = covariance_of_residuals(slopes, space, at, variance=scale)
        scatter = _scatter(problem, slopes, at, scale)
        spread = covariance_of_residuals(slopes, space, at, variance=scale, scatter=scatter) if scatter else plain
        settled = bool(drift) and all(
            abs(moved[name]) <= TINY or _small(drift[name], spread.sd.get(name, math.inf)) for name in space.names
        )
        if not number or settled or number + 1 >= most_recordings:
            tell("intervals", 0.0)
            profiler = Profiler(problem, space, at, scale)
            rises = _rises(plain, spread, normal_quantile(level) ** 2 * scale)
            told = {name: profiler.interval(name, rises[name]) for name in space.names}
            # The first recording serves the whole box: its intervals tell what the later ones have to serve.
            served += _farthest([*profiler.lost, *(profiler.ends if not number else ())], space, at)
            profiled = told if number else {}
        seconds["uncertainty"] += time.perf_counter() - clock
        if profiled and (not profiler.lost or number + 1 >= most_recordings + MORE):
            break
        if profiled or number + 1 < most_recordings:
            record(at, number + 1, served)
    assert spread is not None
    notes += list(dict.fromkeys(s for s in searches[-1].warnings))
    if not settled and drift:
        notes.append(
            f"After {len(searches)} recordings the optimum still moves by more than {SETTLED:g} of a standard "
            "deviation: ask for a smaller standard error of the forward model."
        )
    fresh = _fresh_loss(problem, searches, at)
    count = sum(t.independent for t in targets) + sum(p.prior_sd is not None for p in space.parameters)
    if count <= len(space.free):
        why = "not all can be held" if count < len(space.free) else "nothing is left over to tell the error from"
        notes.append(
            f"{len(space.free)} parameters are free and {count} independent numbers are compared: {why}, and the "
            "intervals say nothing. Measure more wavelengths, or fit fewer parameters."
        )
    lost = [name for name, x in profiled.items() if x.spans]
    if lost:
        notes.append(f"The data do not bound {', '.join(lost)}: the interval reaches from bound to bound.")
    if any(x.rough for x in profiled.values()):
        rough = ", ".join(name for name, x in profiled.items() if x.rough)
        notes.append(
            f"The interval of {rough} is rough: the search for its ends, or the recorded walk, gave out there."
        )
    problem.release()
    return FitOutcome(
        at,
        space,
        tuple(searches),
        drift,
        spread,
        scale,
        correlation,
        identifiability(spread),
        settled,
        losses[-1],
        fresh,
        profiled,
        level,
        tuple(notes),
        seconds,
        pd.concat([s.path.assign(recording=k) for k, s in enumerate(searches)], ignore_index=True),
    )


def _rises(plain: Covariance, spread: Covariance, wanted: float) -> dict[str, float]:
    """Rise of Σ r² at an interval's end: more where the forward model's errors widen what residuals alone would say."""
    ratios = {n: (spread.sd[n] / plain.sd[n]) ** 2 for n in plain.matrix.index if 0 < plain.sd[n] < math.inf}
    most = max([1.0, *(r for r in ratios.values() if math.isfinite(r))])
    return {name: wanted * max(1.0, min(ratios.get(name, most), most)) for name in plain.space.names}


def _farthest(
    lost: Sequence[Mapping[str, float]], space: ParameterSpace, at: Mapping[str, float]
) -> list[Mapping[str, float]]:
    """The points farthest along each way, which a recording that serves them serves the others on the way too."""
    middle = space.vector(at)
    ways: dict[tuple[int, bool], tuple[float, Mapping[str, float]]] = {}
    for values in lost:
        off = space.vector(values) - middle
        k = int(np.argmax(np.abs(off)))
        key = (k, bool(off[k] > 0))
        if key not in ways or abs(off[k]) > ways[key][0]:
            ways[key] = (abs(float(off[k])), values)
    return [values for _, values in ways.values()]


def _small(change: float, sd: float) -> bool:
    return abs(change) <= SETTLED * sd or not math.isfinite(sd)


def _scale(problem: Problem, at: Mapping[str, float], space: ParameterSpace) -> tuple[float, float]:
    """Variance of one residual, and the neighbours' correlation of the residuals.

    With every σ known it is 1. Else the residuals show their own size. Where neighbours are alike, only
    n_e = n (1 − ρ)/(1 + ρ) of n count (Bartlett 1935, first order): Σ r²/n · n_e/(n_e − p) each, and n/n_e times that
    for what they say together.
    """
    r = problem.residuals(at)
    if all(t.loss == "chi2" for t in problem.targets):
        return 1.0, _neighbours(r)
    correlation = _neighbours(r)
    held = max(correlation, 0.0)
    count = max(len(r) * (1.0 - held) / (1.0 + held), len(space.free) + 1.0)
    return float(r @ r) / max(count - len(space.free), 1.0), correlation


def _scatter(
    problem: Problem, slopes: Mapping[str, FloatArray], at: Mapping[str, float], scale: float
) -> dict[tuple[str, str], float] | None:
    """Covariance of Jᵀr by pairs of names, None if the forward model has no errors beyond what the residuals weigh in.

    To the residuals' own it adds that of the forward model, whose errors hang together along the curve and so move the
    parameters more than independent ones.
    """
    shaken = problem.shaken(at)
    if not shaken.any():
        return None
    total = {name: np.array(slopes[name]) for name in problem.space.names}
    for p in problem.space.parameters:
        if p.tied in total and p.name in slopes:
            total[p.tied] = total[p.tied] + p.factor * slopes[p.name]
    made = {}
    for a, left in total.items():
        for b, right in total.items():
            made[a, b] = float(scale * (left @ right) + (left @ shaken) @ (right @ shaken))
        sd = problem.space.by_name[a].prior_sd
        made[a, a] += scale / sd**2 if sd is not None else 0.0
    return made


def _neighbours(r: FloatArray) -> float:
    if len(r) < 3 or not float(r @ r) > 0:
        return 0.0
    return float(np.clip(np.sum(r[1:] * r[:-1]) / np.sum(r * r), -0.99, 0.99))


def _fresh_loss(problem: Problem, searches: Sequence[OptimiseResult], at: Mapping[str, float]) -> float:
    """Σ r² that the last recording gave at the optimum of the one before: the draws did not shape that point."""
    if len(searches) < 2:
        return math.nan
    r = problem.residuals(searches[-2].best)
    return float(r @ r)
