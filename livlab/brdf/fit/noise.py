"""Noise of samples that come without standard errors: from neighbouring pixels, or from repeated directions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from livlab.units import FloatArray

IntArray = npt.NDArray[np.intp]

STATED = "the samples' standard errors"
NEIGHBOURS = "estimated from neighbouring pixels"
REPEATS = "estimated from repeated directions"
UNKNOWN = "samples without standard errors, neighbours or repeats"

FEWEST = 30
"""Differences, or repeats, below which no noise is read from them."""

FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / np.sqrt(70.0)
"""A fourth difference with unit variance: what is cubic over five pixels is none of its noise."""

LEVELS = 12
"""Levels of brightness at which a variance is read before its curve is drawn through them."""


def variance_curve(level: FloatArray, square: FloatArray) -> FloatArray:
    """(3,) coefficients a, b, c ≥ 0 of a variance a + b y + c y² (read noise, photons, gain) of squares at levels y.

    Non-negative least squares on the means over levels, each to its own size.
    """
    from scipy.optimize import nnls

    order = np.argsort(level, kind="stable")
    parts = [p for p in np.array_split(order, min(LEVELS, max(level.size // 10, 1))) if p.size]
    y = np.maximum(np.array([level[p].mean() for p in parts]), 0.0)
    mean = np.array([square[p].mean() for p in parts])
    size = np.maximum(mean, 1e-12 * max(float(mean.max()), 1e-300))
    scale = max(float(y.max()), 1e-300)
    matrix = np.stack([np.ones_like(y), y / scale, (y / scale) ** 2], axis=1) / size[:, None]
    found, _ = nnls(matrix * size.max(), mean / size)
    return np.asarray(found * size.max() / scale ** np.arange(3))


def read_curve(curve: FloatArray, level: FloatArray) -> FloatArray:
    """Standard deviation at levels."""
    y = np.maximum(level, 0.0)
    return np.asarray(np.sqrt(curve[0] + curve[1] * y + curve[2] * y * y))


def of_neighbours(row: IntArray, column: IntArray, y: FloatArray) -> tuple[FloatArray, float] | None:
    """Standard deviation (n, channels) of one light's pixels y, and what it is worth in degrees of freedom.

    From fourth differences along rows and columns, at twelve levels of y. Pixels may be thinned to every n-th. What a
    lobe bends over five pixels counts as noise; noise that neighbours share (demosaicing, blur) does not show.
    None where fewer than thirty such differences are.
    """
    step = min(_step(row), _step(column))
    r, c = (row - row.min()) // step, (column - column.min()) // step
    image = np.full((r.max() + 1, c.max() + 1, y.shape[1]), np.nan)
    image[r, c] = y
    levels, squares = [], []
    for array in (image, image.transpose(1, 0, 2)):
        if array.shape[1] < 5:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(array, 5, axis=1)
        bent, mean = windows @ FOURTH, windows.mean(axis=-1)
        good = np.isfinite(bent).all(axis=-1)
        levels.append(mean[good])
        squares.append(bent[good] ** 2)
    if sum(len(s) for s in squares) < FEWEST:
        return None
    level, square = np.concatenate(levels), np.concatenate(squares)
    sd = [read_curve(variance_curve(level[:, k], square[:, k]), y[:, k]) for k in range(y.shape[1])]
    # Differences share pixels: 1 + 2 (.8² + .4² + .114² + .014²) = 2.63 along a line, and one more with those across.
    return np.stack(sd, axis=1), level.shape[0] / 3.63


def of_repeats(wi: FloatArray, wo: FloatArray, y: FloatArray) -> tuple[FloatArray, float] | None:
    """As `of_neighbours`, of samples whose directions agree to a thousandth of a radian."""
    key = np.round(np.concatenate([wi, wo], axis=1) * 1e3).astype(np.int64)
    _, index, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    again = counts[index] > 1
    dof = int(again.sum() - np.sum(counts > 1))
    if dof < FEWEST:
        return None
    mean = np.stack([np.bincount(index, weights=column) / counts for column in y.T], axis=1)[index]
    square = (y - mean) ** 2 * (counts / np.maximum(counts - 1.0, 1.0))[index][:, None]
    curves = [variance_curve(mean[again, k], square[again, k]) for k in range(y.shape[1])]
    return np.stack([read_curve(c, y[:, k]) for k, c in enumerate(curves)], axis=1), float(dof * y.shape[1])


def _step(numbers: IntArray) -> int:
    apart = np.diff(np.unique(numbers))
    return int(apart.min()) if apart.size else 1
