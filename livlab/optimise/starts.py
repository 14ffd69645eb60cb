"""Where searches begin: the start given, others spread over the box, and what is done if a start fails."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from livlab.errors import InputError
from livlab.optimise.guard import Guard
from livlab.optimise.parameters import ParameterSpace
from livlab.units import FloatArray

RESCUE_POINTS = 64
"""Points tried for one that has a finite cost, where the start has none."""


def finite_near(guard: Guard, point: FloatArray, seed: int) -> FloatArray:
    """The point itself if its cost is finite, else the first such point of a Sobol sequence over the box."""
    if math.isfinite(guard.probe(point)) or not guard.space.free:
        return point
    for other in spread(guard.space, RESCUE_POINTS, seed + 7919):
        if guard.count >= guard.max_evaluations or guard.seconds() >= guard.max_seconds:
            break
        if math.isfinite(guard.probe(other)):
            return other
    return point


def spread(space: ParameterSpace, count: int, seed: int) -> list[FloatArray]:
    """Scrambled Sobol points over the box; about the start, normally spread by its unit, where a bound is infinite."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a count that is no power of 2 is fine here
        shares = qmc.Sobol(len(space.free), rng=np.random.default_rng(seed)).random(count)
    finite = np.isfinite(space.low) & np.isfinite(space.high)
    low, high = np.where(finite, space.low, 0.0), np.where(finite, space.high, 1.0)
    inside = low + (high - low) * shares
    about = space.start + ndtri(np.clip(shares, 1e-6, 1 - 1e-6))
    points = np.clip(np.where(finite, inside, about), space.low, space.high)
    return [np.asarray(point, dtype=np.float64) for point in points]


def starting_points(
    space: ParameterSpace, starts: int | Sequence[Mapping[str, float]], seed: int
) -> tuple[list[FloatArray], list[str]]:
    """The points to start from, and what to say of them.

    Raises
    ------
    InputError
        None asked for, or of unknown parameters.
    """
    if isinstance(starts, int):
        if starts < 1:
            raise InputError.of("starts", starts, "must be at least 1", "Ask for one start or more.")
        points = [space.start]
        if starts > 1 and space.free:
            points += spread(space, starts - 1, seed)
        return points, []
    if not starts:
        raise InputError.of("starts", starts, "is empty", "Give at least one mapping of values.")
    points, notes = [], []
    for number, given in enumerate(starts):
        unknown = sorted(set(given) - set(space.by_name))
        if unknown:
            raise InputError.of(f"starts[{number}]", unknown, "are no parameters", f"Choose from {list(space.names)}.")
        points.append(space.vector(given))
        moved = [p.name for p in space.free if not p.low <= given.get(p.name, p.start_value) <= p.high]
        if moved:
            notes.append(f"start {number} lay outside the bounds of {', '.join(moved)} and was moved onto them")
    return points, notes
