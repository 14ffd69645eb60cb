"""One stage of NLopt behind the guard: whatever happens to it, the best point seen stays, and the reason is told."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from livlab.optimise.algorithms import STOPS, Algorithm, make
from livlab.optimise.guard import Guard
from livlab.units import FloatArray


@dataclass(frozen=True)
class Tolerances:
    """Where a stage ends: share of the value, and of a scaled parameter, by which a step changes it."""

    value: float = 1e-12
    parameter: float = 1e-8


@dataclass(frozen=True)
class StageEnd:
    """Why a stage ended, in words, and whether a tolerance ended it."""

    words: str
    by_tolerance: bool


def run_stage(guard: Guard, stage: Algorithm, x: FloatArray, seed: int, tolerances: Tolerances) -> StageEnd:
    """One stage from x; the guard keeps what it saw."""
    import nlopt

    before = guard.count
    try:
        nlopt.srand(seed + 1)
        opt = make(stage, x.size, gradient=guard.gradient is not None)
        opt.set_lower_bounds(guard.space.low)
        opt.set_upper_bounds(guard.space.high)
        opt.set_min_objective(guard)
        opt.set_ftol_rel(tolerances.value)
        opt.set_xtol_abs(tolerances.parameter)
        opt.set_maxeval(max(1, guard.stage_limit - guard.count) + 1)
        if not stage.is_global and not stage.gradient:
            # A tenth of the box, towards the roomier side; NLopt's own guess shrinks to nothing beside a bound.
            width = guard.space.high - guard.space.low
            opt.set_initial_step(np.where(np.isfinite(width), 0.1 * width, 0.1))
        if math.isfinite(guard.max_seconds):
            opt.set_maxtime(max(1e-3, guard.max_seconds - guard.seconds()))
        guard.opt = opt
        opt.optimize(np.clip(x, guard.space.low, guard.space.high))
        code, why = int(opt.last_optimize_result()), ""
    except KeyboardInterrupt:
        guard.interrupted, code, why = True, -5, ""
        guard.reason = "interrupted by the user"
    except Exception as error:
        # NLopt's own classes (runtime_error, invalid_argument, …) derive from Exception alone and may say nothing; its
        # codes say more. A failure of the objective never comes here: the guard keeps those to itself.
        code, why = _code(error, guard.opt), type(error).__name__
    finally:
        guard.opt = None
    if guard.reason is not None:
        return StageEnd(guard.reason, False)
    words, good = STOPS.get(code, (f"NLopt stopped with code {code}", False))
    if not good and why:
        words = f"{stage.name} failed after {guard.count - before} evaluations: {words} ({why})"
    return StageEnd(words, good)


def _code(error: Exception, opt: object) -> int:
    """NLopt's stop code for what it raised."""
    name = type(error).__name__.lower().replace("_", "")
    known = {"roundofflimited": -4, "forcedstop": -5, "memoryerror": -3, "invalidargument": -2}
    if name in known:
        return known[name]
    try:
        code = int(opt.last_optimize_result())  # type: ignore[attr-defined]
    except Exception:
        return -1
    return code if code < 0 else -1
