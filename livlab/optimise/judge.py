"""What a reader of a search's result should not trust."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from livlab.optimise.guard import Guard
from livlab.optimise.parameters import ParameterSpace
from livlab.units import FloatArray


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
) -> list[str]:
    """Sentences on what a reader should not trust."""
    notes = []
    if not space.free:
        notes.append("no parameter is free: the objective was only evaluated")
    finite = path["value"][np.isfinite(path["value"])]
    level = float(finite.abs().max())
    if space.free and len(finite) > 1 and float(finite.max() - finite.min()) <= 1e-13 * level:
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
