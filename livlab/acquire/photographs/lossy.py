"""What lossy compression took from a picture: measured at the borders of its blocks, by level.

JPEG keeps blocks of 8 x 8 whose errors have nothing to do with each other, while within a block the errors are smooth.
So a line through two pixels on either side of a border meets the one from the other side with a jump,
J = (3 x₈ − x₉)/2 − (3 x₇ − x₆)/2, that the same difference in the middle of a block does not have: there it shows
noise alone. How much larger the jumps' variance is than a pixel's hangs on what was lost: twice, where blocks differ
by constants; twelve times, where a slope became a staircase, since neighbours then err against each other. Half way
between (by logarithms) it is five times, and a pixel's standard error is known to a factor of about two.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.outline import FloatArray

BLOCK = 8
EXCESS = 24**0.5
"""Excess of the jumps' variance over a pixel's variance: between 2 (constants) and 12 (slopes)."""

_BINS = 12
_LEAST = 100


@dataclass(frozen=True, eq=False)
class Scatter:
    """Variance of stored values by lossy compression.

    Attributes
    ----------
    level, variance
        (n, channels) levels in stored values, rising, and the variance there.
    """

    level: FloatArray
    variance: FloatArray

    def at(self, values: NDArray[np.generic]) -> FloatArray:
        """Variance (rows, columns, channels) of stored values."""
        stored = values.astype(np.float64)
        out = np.empty(stored.shape)
        for c in range(stored.shape[-1]):
            out[..., c] = np.interp(stored[..., c], self.level[:, c], self.variance[:, c])
        return out


def measured_scatter(values: NDArray[np.generic], block: int = BLOCK) -> Scatter | None:
    """Scatter of a picture (rows, columns, channels) that was kept in blocks; None if it is too small to show any."""
    if min(values.shape[:2]) < 4 * block:
        return None
    levels, variances = [], []
    for c in range(values.shape[2]):
        x = values[..., c].astype(np.float64)
        border = [np.concatenate(p) for p in zip(_jumps(x, 0, block), _jumps(x.T, 0, block), strict=True)]
        middle = [
            np.concatenate(p) for p in zip(_jumps(x, block // 2, block), _jumps(x.T, block // 2, block), strict=True)
        ]
        edges = np.quantile(border[0], np.linspace(0, 1, _BINS + 1))
        found = []
        for low, high in itertools.pairwise(edges):
            here, there = ((at >= low) & (at <= high) for at, _ in (border, middle))
            if min(here.sum(), there.sum()) < _LEAST:
                continue
            excess = mean_square(border[1][here]) - mean_square(middle[1][there])
            found.append((float(border[0][here].mean()), max(excess, 0.0) / EXCESS))
        if not found:
            return None
        level, variance = np.array(found).T
        places = np.linspace(0, len(level) - 1, _BINS)
        levels.append(np.interp(places, np.arange(len(level)), level))
        variances.append(np.interp(places, np.arange(len(level)), variance))
    return Scatter(np.array(levels).T, np.array(variances).T)


def _jumps(x: FloatArray, shift: int, block: int) -> tuple[FloatArray, FloatArray]:
    """Level and jump down the columns, at the borders of blocks or `shift` pixels past them."""
    last = np.arange(block + shift - 1, len(x) - 2, block)
    a, b, c, d = (x[last + k].ravel() for k in (-1, 0, 1, 2))
    return (b + c) / 2, (3 * c - d) / 2 - (3 * b - a) / 2


def mean_square(x: FloatArray, share: float = 0.95) -> float:
    """Mean square without the largest twentieth, which edges make; made up for as of a normal distribution.

    Unlike a median it is right of values in coarse steps, too: of these alone it is 1/12.
    """
    size = np.abs(x)
    inside = size <= np.quantile(size, share)
    # Of a normal distribution the inner 95 % have .759 of the mean square of all.
    return float(np.mean(x[inside] ** 2)) / (0.759 if inside.mean() < 0.97 else 1.0)
