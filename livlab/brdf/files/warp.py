"""A density on the unit square, bilinear between grid points and linear between slices, and its inverse warp.

The warp takes uniform points of the square to points of that density: first across rows, then within a row (Dupuy &
Jakob 2018, section 4). All sums of a slice are linear in its values, so slices interpolate sum by sum.
"""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def between(planes: FloatArray, knots: FloatArray, at: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Values (n,) of planes (slice, row, column), linear between slices at `knots` and bilinear in u (column), v (row).

    Parameters
    ----------
    planes : (slice, row, column) array
        Grid points reach from edge to edge of the unit square.
    knots : (slice,) array
        Where the slices stand; `at` beyond them takes the last.
    at, u, v : (n,) arrays
        Where the values are wanted; u and v in [0, 1].
    """
    low, high, part = cell(np.interp(at, knots, np.arange(len(knots))), len(knots))
    row0, row1, y = cell(np.clip(v, 0, 1) * (planes.shape[1] - 1), planes.shape[1])
    column0, column1, x = cell(np.clip(u, 0, 1) * (planes.shape[2] - 1), planes.shape[2])

    def plane(k: npt.NDArray[np.intp]) -> FloatArray:
        top = (1 - x) * planes[k, row0, column0] + x * planes[k, row0, column1]
        bottom = (1 - x) * planes[k, row1, column0] + x * planes[k, row1, column1]
        return np.asarray((1 - y) * top + y * bottom)

    return (1 - part) * plane(low) + part * plane(high)


class Warp:
    """The warp of slices (slice, row, column) of non-negative values, each made a density."""

    def __init__(self, planes: FloatArray, knots: FloatArray) -> None:
        self.knots = knots
        sums = (planes[:, :, 1:] + planes[:, :, :-1]) / 2
        within = np.concatenate([np.zeros_like(planes[:, :, :1]), np.cumsum(sums, axis=2)], axis=2)
        rows = within[:, :, -1]
        whole = np.cumsum((rows[:, 1:] + rows[:, :-1]) / 2, axis=1)
        total = whole[:, -1][:, None]
        self.planes = planes / total[:, :, None]
        self.within = within / total[:, :, None]
        self.rows = rows / total
        self.below = np.concatenate([np.zeros_like(total), whole / total], axis=1)

    def invert(self, u: FloatArray, v: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The uniform points that the warp takes to (u, v), at parameters `at`; all (n,)."""
        low, high, part = cell(np.interp(at, self.knots, np.arange(len(self.knots))), len(self.knots))
        row0, row1, y = cell(np.clip(v, 0, 1) * (self.planes.shape[1] - 1), self.planes.shape[1])
        column0, column1, x = cell(np.clip(u, 0, 1) * (self.planes.shape[2] - 1), self.planes.shape[2])

        def mix(first: FloatArray, second: FloatArray) -> FloatArray:
            return (1 - part) * first + part * second

        def row_sum(row: npt.NDArray[np.intp]) -> FloatArray:
            return mix(self.rows[low, row], self.rows[high, row])

        def up_to_u(row: npt.NDArray[np.intp]) -> FloatArray:
            left = mix(self.planes[low, row, column0], self.planes[high, row, column0])
            right = mix(self.planes[low, row, column1], self.planes[high, row, column1])
            start = mix(self.within[low, row, column0], self.within[high, row, column0])
            return start + x * left + x**2 / 2 * (right - left)

        first, second = row_sum(row0), row_sum(row1)
        below = mix(self.below[low, row0], self.below[high, row0])
        across = (1 - y) * up_to_u(row0) + y * up_to_u(row1)
        here = (1 - y) * first + y * second
        return (
            np.divide(across, here, out=np.zeros_like(across), where=here > 0),
            below + y * first + y**2 / 2 * (second - first),
        )


def cell(place: FloatArray, count: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], FloatArray]:
    """The two of `count` points between which a place lies, and its share of the way from the first to the second."""
    low = np.clip(np.floor(place).astype(np.intp), 0, max(count - 2, 0))
    return low, np.minimum(low + 1, count - 1), place - low
