"""How much a function errs by chance or rounding: from values at points so near that a smooth one hardly differs."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from livlab.units import FloatArray

POINTS = 7
"""Values that an estimate takes."""

SPACINGS = tuple(10.0**-k for k in range(6, 13))
"""Distances of neighbouring points tried, as shares of the parameters' sizes."""

NEAR = 40
"""Times that the distances are divided by 10, at most, until the function's value stays about as it is."""

ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Share of a value below which its error is rounding, and no smaller distance is tried."""


def differenced_error(values: ArrayLike) -> float:
    """Standard deviation of the errors of equally spaced values of a smooth function (Moré & Wild 2011).

    The k-th differences of independent errors of variance σ² have the variance σ² (2k)!/(k!)², those of a smooth
    function vanish with k. Of the levels from the second on, the first whose estimate the next repeats within a factor
    of 4 is taken, else the smallest.

    Parameters
    ----------
    values
        (n,) or (n, m) values at n = 5 or more neighbouring points; of m functions the root mean square is given.

    >>> rng = np.random.default_rng(1)
    >>> bool(0.5 < differenced_error(3.0 + 1e-3 * np.arange(200) + rng.standard_normal(200)) < 1.5)
    True
    >>> differenced_error([2.0] * 7)
    0.0
    """
    table = np.asarray(values, dtype=np.float64)
    size = float(np.abs(table).max(initial=0.0))
    if size == 0.0:
        return 0.0
    table = table / size
    levels: list[float] = []
    for k in range(1, len(table) - 1):
        table = np.diff(table, axis=0)
        if k > 1:
            levels.append(math.sqrt(float(np.mean(table**2)) / math.comb(2 * k, k)))
    for one, other in pairwise(levels):
        if one <= 4.0 * other and other <= 4.0 * one:
            return one * size
    return min(levels, default=0.0) * size


def chance_error(
    function: Callable[[FloatArray], ArrayLike], x: FloatArray, low: FloatArray, high: FloatArray, sizes: FloatArray
) -> float:
    """Standard deviation of a function's errors about x; nan if it gives no numbers there.

    All parameters move at once, each by a share of its size and towards its roomier side, and no farther than that the
    value stays about as it is. An error does not fall with the distance of the points, and what is left of a function's
    bend does: the first of several distances that the next one confirms counts.

    Parameters
    ----------
    function
        From (n,) x to one number or several.
    x, low, high, sizes
        (n,) the point, the box, and the parameters' sizes.
    """
    way = np.where(high - x >= x - low, 1.0, -1.0) * sizes
    room = np.where(way > 0, high - x, x - low)
    # Shares of no simple ratio, so that the parameters do not round together.
    way *= 1.0 + 0.37 * np.sin(1.0 + np.arange(x.size))

    def at(spacing: float, k: int) -> FloatArray:
        step = np.minimum(np.abs(way) * spacing, room / POINTS) * np.sign(way)
        return np.asarray(np.ravel(function(x + k * step)), dtype=np.float64)

    here, first = at(0.0, 0), SPACINGS[0]
    for _ in range(NEAR):
        off = float(np.abs(at(first, POINTS - 1) - here).max())
        if off <= 10.0 * float(np.abs(here).max()) or not here.any():
            break
        first *= 0.1
    last = math.nan
    for spacing in SPACINGS:
        values = np.array([here, *(at(first / SPACINGS[0] * spacing, k) for k in range(1, POINTS))])
        if not np.isfinite(values).all():
            continue
        found = differenced_error(values)
        if found <= ROUNDING * float(np.abs(values).max()):
            return found
        if last <= 30.0 * found:
            return last
        last = found
    return last
