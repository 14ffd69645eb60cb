"""Pixels grouped for a fit: single ones in the lobe's core, squares of 2, 4 or 8 where no BRDF can vary fast.

A square is one sample with a larger footprint: its value is the mean of its pixels', weighted by the light that each
received, and a model's prediction is integrated over it. So nothing is thrown away and nothing is approximated beyond
the quadrature, whose step is held below a quarter of the angle over which any lobe changes there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.units import FloatArray

IntArray = npt.NDArray[np.intp]

STEPS = 4.0
"""Steps in the angle over which a lobe can change: θ_h from its axis, and the cosines towards the horizon. Four give
fitted parameters that eight do not change by 1e-5."""

LARGEST = 3
"""Squares have at most 2**LARGEST pixels a side."""

CORE_ORDER, PLAIN_ORDER = 4, 2
"""Gauss–Legendre nodes a side: for a pixel that is wider than the step, and for all else."""


class Square(NamedTuple):
    """Squares of one size and rule: corner row and column, samples (n, side²) that they hold, order of the rule."""

    side: int
    order: int
    row: IntArray
    column: IntArray
    members: IntArray


@dataclass(frozen=True, eq=False)
class Points:
    """What a model is to be evaluated at, for some squares of one light.

    Attributes
    ----------
    cos_i, cos_o, cos_io : (n, k) arrays
        Cosines at the points.
    weight : (n, k) array
        Weights of the points.
    """

    cos_i: FloatArray
    cos_o: FloatArray
    cos_io: FloatArray
    weight: FloatArray


def plan(
    rows: IntArray, columns: IntArray, theta_h: FloatArray, cos_i: FloatArray, cos_o: FloatArray, radius_px: float
) -> list[Square]:
    """Cut one light's pixels into squares.

    Parameters
    ----------
    rows, columns
        (n,) pixels.
    theta_h, cos_i, cos_o
        (n,) angle of the half vector, cosines of the two directions.
    radius_px
        Radius of the sphere's outline in pixels.
    """
    extent = 1.0 / (radius_px * np.maximum(cos_o, 1e-3))
    room = np.minimum(theta_h, np.minimum(cos_i, cos_o)) / STEPS / extent
    level = np.clip(np.floor(np.log2(np.maximum(room, 1e-3))), -1, LARGEST).astype(np.int8)
    align = 1 << LARGEST
    top, left = rows.min() // align * align, columns.min() // align * align
    tall, wide = ((rows.max() - top) // align + 1) * align, ((columns.max() - left) // align + 1) * align
    levels = np.full((tall, wide), -2, dtype=np.int8)
    sample = np.full((tall, wide), -1, dtype=np.intp)
    levels[rows - top, columns - left] = level
    sample[rows - top, columns - left] = np.arange(rows.size)
    squares = []
    for size in range(LARGEST, 0, -1):
        side = 1 << size
        lowest = np.minimum.reduceat(
            np.minimum.reduceat(levels, np.arange(0, tall, side), 0), np.arange(0, wide, side), 1
        )
        at = np.argwhere(lowest >= size)
        if len(at):
            members = sample.reshape(tall // side, side, wide // side, side).transpose(0, 2, 1, 3)[at[:, 0], at[:, 1]]
            members = members.reshape(len(at), side * side)
            levels[rows[members] - top, columns[members] - left] = -2
            squares.append(Square(side, PLAIN_ORDER, at[:, 0] * side + top, at[:, 1] * side + left, members))
    for order, at in ((PLAIN_ORDER, np.argwhere(levels >= 0)), (CORE_ORDER, np.argwhere(levels == -1))):
        if len(at):
            members = sample[at[:, 0], at[:, 1]][:, None]
            squares.append(Square(1, order, at[:, 0] + top, at[:, 1] + left, members))
    return squares


def single_pixels(rows: IntArray, columns: IntArray) -> list[Square]:
    """Each pixel by itself; the order is for the caller to choose."""
    return [Square(1, 1, rows, columns, np.arange(rows.size)[:, None])]


def gauss(order: int) -> tuple[FloatArray, FloatArray]:
    """Offsets (order², 2), column and row, within a square of side 1, and their shares (order²,)."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    across, down = np.meshgrid(0.5 * nodes, 0.5 * nodes)
    return np.stack([across.ravel(), down.ravel()], axis=-1), np.outer(0.5 * weights, 0.5 * weights).ravel()


def midpoints(order: int) -> tuple[FloatArray, FloatArray]:
    """Centres (order², 2) of equal parts of a square of side 1, and their shares."""
    nodes = (np.arange(order) + 0.5) / order - 0.5
    across, down = np.meshgrid(nodes, nodes)
    return np.stack([across.ravel(), down.ravel()], axis=-1), np.full(order * order, 1.0 / order**2)


def see_points(
    camera: Camera,
    sphere: Sphere,
    light: Light,
    square: Square,
    received: FloatArray,
    rule: tuple[FloatArray, FloatArray],
) -> Points:
    """Cosines and weights at the points of squares.

    Parameters
    ----------
    received
        (n,) sum over a square's pixels of E cos θ_i at their centres over the light's intensity.
    rule
        Offsets and shares within a square of side 1.
    """
    offsets, shares = rule
    middle = 0.5 * (square.side - 1)
    columns = square.column[:, None] + middle + square.side * offsets[:, 0]
    rows = square.row[:, None] + middle + square.side * offsets[:, 1]
    origins, directions = camera.rays(columns, rows)
    hits = sphere.meet(origins, directions)
    towards, scale = light.at(hits.points_mm)
    cos_i = np.einsum("nki,nki->nk", towards, hits.normals)
    cos_o = -np.einsum("nki,nki->nk", directions, hits.normals)
    cos_io = -np.einsum("nki,nki->nk", towards, directions)
    good = hits.hit & (cos_i > 0) & (cos_o > 0)
    weight = np.where(good, shares * square.side**2 * scale * cos_i, 0.0) / received[:, None]
    return Points(cos_i, cos_o, cos_io, weight)
