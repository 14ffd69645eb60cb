"""The inner loop of a ledger's answers, compiled: e^(θ·x + w) over rows and settings, and its sums.

Import only on use: it brings in numba.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from livlab.core.compiled import compiled
from livlab.units import FloatArray

TILE = 8
"""Rows at a time when features are summed."""


_LOG2E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ROUND = 6755399441055744.0  # 1.5 · 2⁵²: adding it leaves the nearest integer in the last bits


@numba.njit(inline="always")  # type: ignore[untyped-decorator]
def _exp(x: float) -> float:
    """eˣ to 1e-14 of itself in operations that vectorise; beyond ±700 as at ±700."""
    x = min(max(x, -700.0), 700.0)
    t = x * _LOG2E + _ROUND
    n = t - _ROUND
    r = (x - n * _LN2_HIGH) - n * _LN2_LOW
    p = 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    bits = np.int64(np.float64(t).view(np.int64) << 52) + np.int64(0x3FF0000000000000)
    return p * np.int64(bits).view(np.float64)


def _accumulate(
    x: NDArray[np.float32],
    log_weight: NDArray[np.float32],
    concentration: NDArray[np.float32],
    theta: FloatArray,
    directions: FloatArray,
    every: int,
    count: FloatArray,
    square: FloatArray,
    features: FloatArray,
    slope: FloatArray,
    slope_square: FloatArray,
) -> None:
    """Add rows x (N, F) at exponents theta (F, S) to sums of (S,), (S,), (F, S), (D, S), (D, S).

    `directions` is (D, F, S). Features are summed over one tile in `every`, times that.
    F must be a multiple of 4; S had better be one of 32.
    """
    rows, width = x.shape
    sets = theta.shape[1]
    e = np.zeros((TILE, sets))
    along = np.empty(sets)
    one = np.zeros((TILE, width))
    for start in range(0, rows, TILE):
        n = min(TILE, rows - start)
        for i in range(n):
            for f in range(width):
                one[i, f] = np.float64(x[start + i, f])
            row = e[i]
            row[:] = np.float64(log_weight[start + i])
            _dot(one[i], theta, row)
            _weigh(row, np.float64(concentration[start + i]), count, square)
        if (start // TILE) % every == 0:
            for i in range(n, TILE):
                e[i, :] = 0.0
            _gather(one, e, features)
        for d in range(directions.shape[0]):
            for i in range(n):
                along[:] = 0.0
                _dot(one[i], directions[d], along)
                _slope(e[i], along, np.float64(concentration[start + i]), slope[d], slope_square[d])
    for f in range(width):
        for s in range(sets):
            features[f, s] *= every


# Each loop below writes few arrays and reads at most eight: more, and LLVM gives up proving them apart.


@numba.njit(nogil=True)  # type: ignore[untyped-decorator]
def _dot(one: FloatArray, theta: FloatArray, e: FloatArray) -> None:
    for f in range(0, theta.shape[0], 4):
        t0, t1, t2, t3 = theta[f], theta[f + 1], theta[f + 2], theta[f + 3]
        a0, a1, a2, a3 = one[f], one[f + 1], one[f + 2], one[f + 3]
        for s in range(e.size):
            e[s] += (a0 * t0[s] + a1 * t1[s]) + (a2 * t2[s] + a3 * t3[s])


@numba.njit(nogil=True)  # type: ignore[untyped-decorator]
def _weigh(e: FloatArray, q: float, count: FloatArray, square: FloatArray) -> None:
    for s in range(e.size):
        v = _exp(e[s])
        e[s] = v
        count[s] += v
        square[s] += q * v * v


@numba.njit(nogil=True)  # type: ignore[untyped-decorator]
def _slope(e: FloatArray, along: FloatArray, q: float, slope: FloatArray, square: FloatArray) -> None:
    for s in range(e.size):
        v = e[s] * along[s]
        slope[s] += v
        square[s] += q * v * v


@numba.njit(nogil=True)  # type: ignore[untyped-decorator]
def _gather(one: FloatArray, e: FloatArray, features: FloatArray) -> None:
    e0, e1, e2, e3, e4, e5, e6, e7 = e[0], e[1], e[2], e[3], e[4], e[5], e[6], e[7]
    for f in range(features.shape[0]):
        t = features[f]
        a0, a1, a2, a3 = one[0, f], one[1, f], one[2, f], one[3, f]
        a4, a5, a6, a7 = one[4, f], one[5, f], one[6, f], one[7, f]
        for s in range(t.size):
            v0 = (a0 * e0[s] + a1 * e1[s]) + (a2 * e2[s] + a3 * e3[s])
            t[s] += v0 + ((a4 * e4[s] + a5 * e5[s]) + (a6 * e6[s] + a7 * e7[s]))


accumulate = compiled(_accumulate, nogil=True)
