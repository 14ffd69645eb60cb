"""What a reader of a search's result should not trust."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from livlab.optimise.guard import Guard
from livlab.optimise.parameters import AT_BOUND, ParameterSpace
from livlab.optimise.result import Convergence
from livlab.units import FloatArray


def settle_on_bounds(guard: Guard, noise: float) -> bool:
    """Move what lies within a hair of a bound onto it, unless the objective tells the two apart; whether this was done.

    A parameter near its bound is not at it where the objective there is higher by more than its noise.
    """
    assert guard.best_x is not None
    space, floor = guard.space, 3.0 * noise if math.isfinite(noise) else 0.0
    width = np.where(np.isfinite(space.high - space.low), space.high - space.low, 1.0)
    for k in range(guard.best_x.size):
        for bound in (float(space.low[k]), float(space.high[k])):
            if guard.best_x[k] == bound or abs(guard.best_x[k] - bound) > AT_BOUND * width[k]:
                continue
            if guard.over():
                return False
            moved = guard.best_x.copy()
            moved[k] = bound
            value, before = guard.probe(moved), guard.best
            if value <= before + floor:
                guard.settle(moved, value)
    return True


def does_nothing(guard: Guard, best: FloatArray, name: str) -> bool:
    """Whether a hundredth of the box (or of the unit) in one parameter leaves the objective as it is."""
    space = guard.space
    k = space.names.index(name)
    width = space.high[k] - space.low[k]
    step = 0.01 * (width if math.isfinite(width) else 1.0)
    moved = best.copy()
    moved[k] += step if moved[k] + step <= space.high[k] else -step
    try:
        return float(guard.objective(space.values(moved))) == float(guard.objective(space.values(best)))
    except Exception:
        return False


def sentences(
    guard: Guard,
    space: ParameterSpace,
    status: dict[str, str],
    values: dict[str, float],
    path: pd.DataFrame,
    idle: list[str],
    convergence: Convergence,
) -> list[str]:
    """Sentences on what a reader should not trust."""
    notes = []
    if not space.free:
        notes.append("no parameter is free: the objective was only evaluated")
    finite = path["value"][np.isfinite(path["value"])]
    still = len(finite) > 1 and float(finite.max() - finite.min()) <= 1e-13 * float(finite.abs().max())
    if space.free and still and (convergence.flat or math.isnan(convergence.decrease)):
        notes.append("the objective is flat: it did not change over the points tried, so the parameters mean nothing")
    for name, word in status.items():
        if word.startswith("at "):
            notes.append(f"{name} = {values[name]:.6g} sits {word}: the optimum may lie beyond it")
        elif name in idle:
            notes.append(f"{name} = {values[name]:.6g} is as it started: the objective does not depend on it there")
    if guard.failures:
        why = f", the first by {guard.first_error!r}" if guard.first_error else " (no finite number)"
        notes.append(f"{guard.failures} of {guard.count} evaluations failed{why}")
    elif guard.first_error is not None:
        notes.append(f"the gradient failed, first by {guard.first_error!r}")
    return notes
