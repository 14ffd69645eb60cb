"""The search itself: starts, stages, limits, and everything that can go wrong, told."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from livlab.errors import InputError, Interrupted
from livlab.optimise.algorithms import STOPS, Algorithm, choose, make
from livlab.optimise.guard import Callback, Gradient, Guard, Objective
from livlab.optimise.judge import does_nothing, sentences
from livlab.optimise.parameters import Parameter, ParameterSpace
from livlab.optimise.result import FitWarning, OptimiseResult
from livlab.optimise.starts import finite_near, starting_points
from livlab.units import FloatArray

EVALUATIONS_PER_PARAMETER = 500
GLOBAL_SHARE = 0.6


def minimise(
    objective: Objective,
    parameters: Sequence[Parameter] | ParameterSpace,
    *,
    gradient: Gradient | None = None,
    algorithm: str | tuple[str, ...] = "auto",
    starts: int | Sequence[Mapping[str, float]] = 1,
    max_evaluations: int | None = None,
    max_seconds: float = math.inf,
    value_tolerance: float = 1e-12,
    parameter_tolerance: float = 1e-8,
    seed: int = 0,
    callback: Callback | None = None,
    one_sigma: float = 0.5,
    warn: bool = True,
) -> OptimiseResult:
    """Minimise an objective over named parameters with NLopt (Johnson 2007).

    Global stages run once over the box; then the local stages run from the best point and from every further start.

    Parameters
    ----------
    objective
        Takes a mapping of all parameters by name, gives a number. A call that raises or gives no finite number is
        recorded with infinite cost and the search goes on.
    parameters
        See `Parameter`.
    gradient
        Takes the same mapping, gives the objective's derivative by each parameter (missing names count as 0),
        without the priors' part.
    algorithm
        "auto", or the name of one stage, or of several from global to local: GN_CRS2_LM, GN_DIRECT_L, G_MLSL_LDS,
        GN_ISRES, GN_AGS; LD_MMA, LD_SLSQP, LD_LBFGS with a gradient; LN_BOBYQA, LN_SBPLX without. "auto" is LD_SLSQP
        with a gradient, else GN_CRS2_LM then LN_BOBYQA in a finite box, else LN_BOBYQA.
    starts
        How many, the first at the parameters' own starts and the others spread by a scrambled Sobol sequence over
        the box (about the start where a bound is infinite); or a list of mappings.
    max_evaluations, max_seconds
        Limits of the whole call; 500 evaluations for each free parameter and start (plus one) if not given.
    value_tolerance
        A stage ends where the value changes by less than this share.
    parameter_tolerance
        A stage ends where no scaled parameter (its box is 1) changes by more.
    seed
        Of the starts and of NLopt's random algorithms.
    callback
        Gets (evaluation, values, value) after each call; stops the search by returning False.
    one_sigma
        Rise of the objective that marks one standard deviation: ½ of a negative log-likelihood, 1 of a χ².
    warn
        Also raise each warning of the result as a `FitWarning`.

    Returns
    -------
    OptimiseResult
        The best point seen, whatever stopped the search.

    Raises
    ------
    InputError
        Unusable parameters, starts or limits; an algorithm that does not fit; an objective that is nowhere finite.
    Interrupted
        The user stopped it before any point had a finite value.

    Examples
    --------
    >>> box = [Parameter("a", -2, 2, 0.5), Parameter("b", 1e-3, 10, 1.0, transform="log")]
    >>> found = minimise(lambda p: (p["a"] - 1) ** 2 + (p["b"] - 0.25) ** 2, box, algorithm="LN_BOBYQA")
    >>> round(found.best["a"], 5), round(found.best["b"], 5)
    (1.0, 0.25)
    """
    space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
    free = len(space.free)
    points, notes = starting_points(space, starts, seed)
    _check_limits(max_evaluations, max_seconds, one_sigma)
    limit = max_evaluations or EVALUATIONS_PER_PARAMETER * (free + 1) * len(points)
    guard = Guard(
        objective,
        gradient,
        space,
        one_sigma=one_sigma,
        max_evaluations=limit,
        max_seconds=max_seconds,
        callback=callback,
    )
    chosen: tuple[Algorithm, ...] = ()
    if free:
        boxed = not space.finite_box()
        chosen = choose(algorithm, free=free, gradient=gradient is not None, boxed=boxed)
    search = _Search(tuple(points), chosen, seed, value_tolerance, parameter_tolerance)
    rows: list[dict[str, Any]] = []
    for number in range(len(points)):
        if guard.interrupted or guard.halted or (number and (guard.count >= limit or guard.seconds() >= max_seconds)):
            break
        rows.append(_one_start(guard, search, number))
    result = _result(guard, search, rows, notes)
    if warn:
        for sentence in result.warnings:
            warnings.warn(sentence, FitWarning, stacklevel=2)
    return result


@dataclass(frozen=True, eq=False)
class _Search:
    """What is run: stages from each point, until the tolerances."""

    points: tuple[FloatArray, ...]
    stages: tuple[Algorithm, ...]
    seed: int
    value_tolerance: float
    parameter_tolerance: float

    @property
    def algorithm(self) -> str:
        """The stages in words."""
        return " + ".join(s.name for s in self.stages) or "none"


def _one_start(guard: Guard, search: _Search, number: int) -> dict[str, Any]:
    """The stages from one point: where it ended, and how."""
    point, seed, chosen = search.points[number], search.seed, search.stages
    before, x, stop, converged = guard.count, point, "nothing was free to vary", True
    guard.begin(number, "start", guard.max_evaluations)
    try:
        x = finite_near(guard, point, seed + number)
    except KeyboardInterrupt:
        guard.interrupted, stop, converged = True, "interrupted by the user", False
    stages = [s for s in chosen if number == 0 or not s.is_global] or list(chosen)
    found, value = x, guard.local
    for k, stage in enumerate(stages):
        if guard.interrupted or guard.halted:
            break
        left = guard.max_evaluations - guard.count
        share = GLOBAL_SHARE if stage.is_global and k + 1 < len(stages) else 1.0 / (len(search.points) - number)
        guard.begin(number, stage.name, guard.count + max(1, int(share * left)))
        stop, converged = _run(guard, search, stage, x, seed + number)
        if guard.local_x is not None and guard.local <= value:
            x = found = guard.local_x
            value = guard.local
    began = {f"start_{n}": v for n, v in guard.space.values(point).items() if n in guard.space.names}
    ended = {n: v for n, v in guard.space.values(found).items() if n in guard.space.names}
    return {
        "value": value,
        "evaluations": guard.count - before,
        "converged": converged and math.isfinite(value),
        "stop": stop,
        **began,
        **ended,
    }


def _run(guard: Guard, search: _Search, stage: Algorithm, x: FloatArray, seed: int) -> tuple[str, bool]:
    """One stage of NLopt from x; the guard keeps what it saw."""
    import nlopt

    nlopt.srand(seed + 1)
    opt = make(stage, x.size, gradient=guard.gradient is not None)
    opt.set_lower_bounds(guard.space.low)
    opt.set_upper_bounds(guard.space.high)
    opt.set_min_objective(guard)
    opt.set_ftol_rel(search.value_tolerance)
    opt.set_xtol_abs(search.parameter_tolerance)
    opt.set_maxeval(max(1, guard.stage_limit - guard.count) + 1)
    if not stage.is_global and not stage.gradient:
        # A tenth of the box, towards the roomier side; NLopt's own guess shrinks to nothing beside a bound.
        width = guard.space.high - guard.space.low
        opt.set_initial_step(np.where(np.isfinite(width), 0.1 * width, 0.1))
    if math.isfinite(guard.max_seconds):
        opt.set_maxtime(max(1e-3, guard.max_seconds - guard.seconds()))
    guard.opt = opt
    try:
        opt.optimize(x)
        code = int(opt.last_optimize_result())
    except nlopt.RoundoffLimited:
        code = -4
    except nlopt.ForcedStop:
        code = -5
    except KeyboardInterrupt:
        guard.interrupted, code = True, -5
        guard.reason = "interrupted by the user"
    except MemoryError:
        code = -3
    except (RuntimeError, ValueError):
        code = int(opt.last_optimize_result())
        code = code if code < 0 else -1
    finally:
        guard.opt = None
    if guard.reason is not None:
        return guard.reason, False
    words, converged = STOPS.get(code, (f"NLopt stopped with code {code}", False))
    return words, converged


def _check_limits(max_evaluations: int | None, max_seconds: float, one_sigma: float) -> None:
    if max_evaluations is not None and max_evaluations < 1:
        raise InputError.of("max_evaluations", max_evaluations, "must be at least 1", "Allow one evaluation or more.")
    if not max_seconds > 0:
        raise InputError.of("max_seconds", max_seconds, "must be > 0", "Allow some time.")
    if not (one_sigma > 0 and math.isfinite(one_sigma)):
        raise InputError.of("one_sigma", one_sigma, "must be > 0", "Use 0.5 for a log-likelihood, 1 for chi-square.")


def _result(guard: Guard, search: _Search, rows: list[dict[str, Any]], notes: list[str]) -> OptimiseResult:
    """The best point of all starts, and what to mistrust about it."""
    best, space = _best_point(guard), guard.space
    winner = min(range(len(rows)), key=lambda k: float(rows[k]["value"]))
    status = space.status(best, search.points[winner])
    values = space.values(best)
    path = guard.path()
    idle = [name for name, word in status.items() if word.startswith("unchanged") and does_nothing(guard, best, name)]
    starts = pd.DataFrame(rows)
    starts.index.name = "start"
    return OptimiseResult(
        best=values,
        value=guard.best,
        status=status,
        evaluations=guard.count,
        failures=guard.failures,
        seconds=guard.seconds(),
        stop="interrupted by the user" if guard.interrupted else str(rows[winner]["stop"]),
        converged=bool(rows[winner]["converged"]) and not guard.interrupted,
        interrupted=guard.interrupted,
        path=path,
        starts=starts,
        warnings=(*notes, *sentences(guard, space, status, values, path, idle)),
        algorithm=search.algorithm,
        seed=search.seed,
        one_sigma=0.5 * guard.prior_scale,
    )


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
