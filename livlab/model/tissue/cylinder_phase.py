"""Phase function of infinite cylinders whose axes point in all directions alike."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.cylinder import bessel_pair, gauss_angles
from livlab.model.tissue.mie import sphere_arguments
from livlab.model.tissue.phase import Tabulated
from livlab.units import FloatArray

_NODES = 512
_CELLS = 480
_SMALLEST = 1e-7
"""First cell of 1 − cos Θ: light in it is turned by less than 0.03°."""


def cylinder_phase(m: complex, x: float, cells: int = _CELLS) -> Tabulated:
    """Phase function for unpolarised light and axes in all directions alike, as a table.

    At an angle ζ to the axis light leaves on the cone cos Θ = cos²ζ + sin²ζ cos φ with
    f(φ) = (|T1|² + |T2|² + 2 |T3|²)/2 (Bohren & Huffman 1983, eq. 8.38). f is a cosine series in φ, so the share
    between two cosines is known in closed form for each ζ; shares are summed over ζ with weight sin ζ and spread
    evenly in each cell of 1 − cos Θ. The mean diverges as (1 − cos Θ)^(−1/2) in the forward direction, which no
    table of values could hold; shares can.

    Parameters
    ----------
    m, x
        As in `cylinder`, scalars.
    cells
        Number of cells of 1 − cos Θ, at least 16, equally wide in its logarithm below 0.05 and in Θ above.

    Returns
    -------
    Tabulated
        Its anisotropy agrees with `cylinder_mean`'s within 5e-4 at the default number of cells.

    Raises
    ------
    InputError
        As `cylinder`, if an argument is no scalar, or if cells is below 16.

    Examples
    --------
    >>> from livlab.model.tissue.cylinder import cylinder_mean
    >>> phase = cylinder_phase(1.5 / 1.35, 5.0)
    >>> abs(phase.anisotropy - float(cylinder_mean(1.5 / 1.35, 5.0).anisotropy)) < 5e-4
    True
    """
    if cells < 16:
        raise InputError.of("cells", cells, "must be at least 16", "Leave it out.")
    index, size = sphere_arguments(m, x)
    if index.ndim:
        raise InputError.of("m, x", index.shape, "must be scalars", "Call once for each cylinder.")
    return _phase(complex(index), float(size), int(cells))


@lru_cache(maxsize=512)
def _phase(m: complex, x: float, cells: int) -> Tabulated:
    from livlab.model.tissue.cylinder_kernels import cone_shares, orders

    zeta, weight = gauss_angles(m, max(_NODES, 2 ** math.ceil(math.log2(16.0 + 4.0 * x))))
    sine, cosine = np.sin(zeta), np.cos(zeta)
    edges = _edges(cells)
    inside = np.conj(m)
    shares = cone_shares(
        (inside - 1.0) * (inside + 1.0), x, sine, cosine, weight, bessel_pair(x * sine), orders(x) + 1, edges
    )
    return _table(edges, np.asarray(shares))


def _edges(cells: int) -> FloatArray:
    fine = cells // 2
    near = np.geomspace(_SMALLEST, 0.05, fine)
    far = 1.0 - np.cos(np.linspace(math.acos(0.95), math.pi, cells - fine + 1))
    return np.concatenate([[0.0], near, far[1:-1], [2.0]])


def _table(edges: FloatArray, shares: FloatArray) -> Tabulated:
    """A table that is constant in each cell, but for a ramp of a millionth of the cell's width at its edges."""
    density = np.clip(shares, 0.0, None) / np.diff(edges)
    width = np.diff(edges)
    low = edges[:-1] + 1e-6 * width
    low[0] = 0.0
    high = edges[1:] - 1e-6 * width
    high[-1] = 2.0
    w = np.column_stack([low, high]).ravel()
    return Tabulated.from_complement(w, np.repeat(density, 2))
