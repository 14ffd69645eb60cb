"""Euclidean distance transform in float32, in place: 4 bytes a node where scipy's needs about 50.

Import only on use: it brings in numba.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from livlab.core.compiled import compiled

_FAR = np.float32(1e12)


def distance_to(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance of each node of a 3-D grid to the nearest node of the mask, in units of the spacing.

    Felzenszwalb & Huttenlocher 2012, eq. 4: along one axis after another the lower envelope of parabolas.

    >>> distance_to(np.array([[[True, False, False, False]]])).tolist()
    [[[0.0, 1.0, 2.0, 3.0]]]
    """
    squared = np.where(mask, np.float32(0), _FAR)
    longest = max(mask.shape)
    for axis in range(3):
        _envelope(np.moveaxis(squared, axis, 2), np.zeros(longest, np.int64), np.zeros(longest + 1), np.zeros(longest))
    return np.sqrt(squared, out=squared)


@compiled
def _envelope(
    values: NDArray[np.float32], places: NDArray[np.int64], starts: NDArray[np.float64], line: NDArray[np.float64]
) -> None:
    """Replace each line along the last axis by min over q of (p - q)² + line[q]."""
    count = values.shape[2]
    for a in range(values.shape[0]):
        for b in range(values.shape[1]):
            top = -1
            for q in range(count):
                line[q] = values[a, b, q]
                if line[q] >= 1e12:  # a line without the mask stays far
                    continue
                start = -np.inf
                while top >= 0:
                    p = places[top]
                    start = ((line[q] + q * q) - (line[p] + p * p)) / (2.0 * (q - p))
                    if start > starts[top]:
                        break
                    top -= 1
                if top < 0:
                    start = -np.inf
                top += 1
                places[top] = q
                starts[top] = start
            if top < 0:
                continue
            k = 0
            for q in range(count):
                while k < top and starts[k + 1] < q:
                    k += 1
                p = places[k]
                values[a, b, q] = (q - p) * (q - p) + line[p]
