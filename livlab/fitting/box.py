"""Where a box of parameters holds no tissue, fractions that pass 1 for one: told before any light.

Constraints of a tissue hold between values: each may lie within its own bounds and two together not. So a box is tried
at its corners; an end that nothing can reach is a slip of its bounds, a corner that is cut off is no more than that.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from livlab.errors import InputError, LivlabError
from livlab.units import FloatArray

ALL_CORNERS = 6
"""Parameters up to which every corner of the box is tried; of more, those that matter and some by chance."""

BY_CHANCE = 48
"""Corners tried by chance beyond that."""

POINTS = 128
"""Points that tell what share of the box holds no tissue."""

INSET = 1e-6
"""Share of the box by which its corners are drawn in: an open bound (a length > 0) is no wall."""

HALVINGS = 32
"""Bisections of a way that leads out of the tissues."""

At = Callable[[FloatArray], object]
"""Makes the tissue at a point of the unit cube, or raises a LivlabError."""


@dataclass(frozen=True, eq=False)
class Limit:
    """Where a parameter leaves the tissues.

    Attributes
    ----------
    dimension, high
        Which parameter, and on the way to which end.
    at
        Point of the unit cube, the last that is a tissue.
    error
        What is wrong at that end.
    """

    dimension: int
    high: bool
    at: FloatArray
    error: LivlabError


@dataclass(frozen=True, eq=False)
class BoxSurvey:
    """What of a box is tissue.

    Attributes
    ----------
    empty
        Share of the box that is none.
    limits
        Ends that no tissue reaches, whatever the other parameters are.
    error
        What is wrong at the first point that is none; None where everything tried is a tissue.
    """

    empty: float = 0.0
    limits: tuple[Limit, ...] = ()
    error: LivlabError | None = None


def why_not(at: At, u: FloatArray) -> LivlabError | None:
    """What is wrong at a point of the unit cube; None if it is a tissue."""
    try:
        at(u)
    except LivlabError as error:
        return error
    return None


def survey(at: At, start: FloatArray, seed: int = 0) -> BoxSurvey:
    """What of a box is tissue: its corners, ends that cannot be reached, and the share that is none.

    Parameters
    ----------
    at
        The tissue at a point of the unit cube.
    start
        (D,) a point that is one.
    seed
        Of the corners and points that are tried by chance.
    """
    tried = [(corner, why_not(at, _drawn_in(corner))) for corner in corners(len(start), seed)]
    wrong = [error for _, error in tried if error is not None]
    if not wrong:
        return BoxSurvey()
    reached = [corner for corner, error in tried if error is None]
    limits = []
    for k, end in itertools.product(range(len(start)), (0.0, 1.0)):
        if not any(corner[k] == end for corner in reached):
            limit = way_out(at, start, k, end)
            limits += [limit] if limit is not None else []
    if limits:
        return BoxSurvey(1.0, tuple(limits), wrong[0])
    return BoxSurvey(empty_share(at, len(start), seed), (), wrong[0])


def corners(dimensions: int, seed: int) -> list[FloatArray]:
    """(D,) corners of the unit cube to try: all of a small one; of a large one each side's ends, and some by chance."""
    if dimensions <= ALL_CORNERS:
        return [np.array(c, dtype=np.float64) for c in itertools.product((0.0, 1.0), repeat=dimensions)]
    low, high, one = np.zeros(dimensions), np.ones(dimensions), np.eye(dimensions)
    random = (np.random.default_rng(seed).random((BY_CHANCE, dimensions)) < 0.5).astype(np.float64)
    return [low, high, *one, *(high - one), *random]


def _drawn_in(corner: FloatArray) -> FloatArray:
    return np.clip(corner, INSET, 1.0 - INSET)


def way_out(at: At, start: FloatArray, k: int, end: float) -> Limit | None:
    """Where the way of one parameter to an end leaves the tissues, with the others where they leave most room.

    None if it does not: with the others at their start, at their least or at their most the end is a tissue.
    """
    best: Limit | None = None
    for others in (start, _drawn_in(np.zeros_like(start)), _drawn_in(np.ones_like(start))):
        begin, there = others.copy(), others.copy()
        begin[k], there[k] = start[k], end
        if why_not(at, begin) is not None:
            continue
        limit = between(at, begin, there, k)
        if limit is None or abs(limit.at[k] - end) <= INSET:
            return None
        if best is None or abs(limit.at[k] - end) < abs(best.at[k] - end):
            best = limit
    return best


def between(at: At, good: FloatArray, there: FloatArray, k: int) -> Limit | None:
    """The last tissue on the way from one to a point that may be none; None if that is one, too."""
    error = why_not(at, there)
    if error is None:
        return None
    a, b = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (a + b)
        if why_not(at, good + middle * (there - good)) is None:
            a = middle
        else:
            b = middle
    return Limit(k, bool(there[k] > good[k]), good + a * (there - good), error)


def empty_share(at: At, dimensions: int, seed: int) -> float:
    """Share of the box that is no tissue, by a low-discrepancy design."""
    from scipy.stats import qmc

    points = qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random(POINTS)
    return sum(why_not(at, u) is not None for u in points) / POINTS


def refused(limit: Limit, field: str, bound: str, given: float, value: float, name: str) -> InputError:
    """What to say of a bound that no tissue reaches.

    Parameters
    ----------
    limit
        Where it leaves the tissues.
    field, name
        Whose bound it is ("parameter blood fraction"), and how the value is called.
    bound, given
        "high" or "low", and what was given.
    value
        The last value that makes a tissue.
    """
    where = "above" if limit.high else "below"
    value = value if abs(value) > 2.0 * INSET * abs(given) else 0.0
    return InputError.of(
        f"{field}.{bound}", given,
        f"does not fit, since there is no tissue {where} {name} = {value:.4g}, whatever the others are: "
        f"{limit.error.message.rstrip('.')}",
        f"Give {bound} = {_inside(value, limit.high):.4g} or mend the tissue. {limit.error.remedy}".rstrip(),
    )  # fmt: skip


def _inside(value: float, high: bool) -> float:
    """A value of four digits that is on the right side of a limit.

    >>> f"{_inside(0.010019, True):g}, {_inside(0.010011, False):g}"
    '0.01001, 0.01002'
    """
    if value == 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 3)
    return float((math.floor if high else math.ceil)(value / unit + (1e-3 if high else -1e-3)) * unit)


__all__ = ["BoxSurvey", "Limit", "between", "corners", "empty_share", "refused", "survey", "way_out", "why_not"]
