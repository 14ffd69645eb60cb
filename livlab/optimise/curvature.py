"""The curvature of Σ r² about a point: what linear residuals make of it, and what their own bend adds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from livlab.optimise.levenberg import SearchPoint
from livlab.units import FloatArray

LOST = 1e-7
"""Share of its largest length below which a column is lost: its parameter does nothing there."""

REACH = 0.03
"""Step along an axis for the residuals' bend, as a share of the axis."""

FLAT = 1e-14
"""Share of Σ r² by which an axis of length one must change it, or it counts as flat."""

LEAST = 1e-3
"""Curvature, as a share of what each axis has alone, below which no Newton's step relies on it."""


@dataclass(frozen=True, eq=False)
class Curvature:
    """Axes about x: with δ = axes · u, Σ r² = |r|² (1 + 2 slope · u + uᵀ bend u) near u = 0.

    Attributes
    ----------
    axes
        (n, k) displacements of x, by which linear residuals change by their own length, or as long as the parameters
        are large where that is less.
    bend
        (k, k) the curvature, scaled to about unit diagonal by `scale`.
    scale
        (k,) root of each axis's own curvature.
    down
        (n, j) displacements along which Σ r² bends downwards.
    lost
        (n,) whether a parameter does nothing here, though it did elsewhere.
    """

    axes: FloatArray
    bend: FloatArray
    scale: FloatArray
    down: FloatArray
    lost: FloatArray

    def slope(self, point: SearchPoint) -> FloatArray:
        """(k,) half the derivative of Σ r² by u, over |r|² and `scale`."""
        return np.asarray(self.axes.T @ (point.matrix.T @ point.r)) / (point.cost * self.scale)

    def newton(self, point: SearchPoint) -> tuple[FloatArray, float]:
        """(n,) the step to the lowest point of the parabola, and the share of Σ r² that it promises."""
        values, vectors = np.linalg.eigh(self.bend)
        parts, firm = vectors.T @ self.slope(point), np.maximum(values, LEAST)
        u = -(vectors @ (parts / firm)) / self.scale
        return self.axes @ u, float(np.sum(parts**2 / firm))

    def hidden(self, point: SearchPoint, errors: FloatArray) -> float:
        """Share of Σ r² that errors of its derivatives by x, (n,) lengths, alone would promise."""
        off = (np.abs(self.axes).T @ errors) / (point.cost * self.scale)
        return float(np.sum(off**2))


def curvature(
    point: SearchPoint,
    errors: FloatArray,
    lengths: FloatArray,
    sizes: FloatArray,
    box: tuple[FloatArray, FloatArray],
    derivatives: Callable[[FloatArray], FloatArray] | None,
) -> Curvature:
    """The curvature of the parameters that are free at a point.

    A parameter on a bound that the slope pushes against is not free, nor one that does nothing.

    Parameters
    ----------
    point
        Where, with its residuals and their derivatives.
    errors, lengths
        (n,) errors of the derivatives' columns, as lengths, and the largest length that each column had.
    sizes
        (n,) of the parameters.
    box
        Bounds of x.
    derivatives
        From x to the residuals' derivatives; the residuals count as linear if not given.
    """
    (low, high), x, n = box, point.x, point.x.size
    slope, own, size = point.matrix.T @ point.r, np.linalg.norm(point.matrix, axis=0), math.sqrt(point.cost)
    held = ((x <= low) & (slope >= 0.0)) | ((x >= high) & (slope <= 0.0))
    # What never did anything is no loss; what stopped doing anything is.
    lost = (own <= LOST * lengths) & (lengths > 0.0) & ~held
    free = np.flatnonzero(~held & (own > LOST * lengths))
    if free.size == 0 or size == 0.0:
        none = np.zeros((n, 0))
        return Curvature(none, np.zeros((0, 0)), np.zeros(0), none, lost)
    _, values, right = np.linalg.svd(point.matrix[:, free] / own[free], full_matrices=False)
    values = np.concatenate([values, np.zeros(free.size - values.size)])
    if len(right) < free.size:  # fewer residuals than parameters
        right = np.linalg.svd(point.matrix[:, free] / own[free], full_matrices=True)[2]
    axes = np.zeros((n, free.size))
    axes[free] = right.T / own[free, None]
    most = np.maximum(sizes, size / np.where(own > 0, own, np.inf))
    room = np.min(most[free, None] / np.maximum(np.abs(axes[free]), 1e-300), axis=0)
    reach = np.minimum(room, size / np.maximum(values, 1e-300))
    axes = axes * reach
    alone, bend = (values * reach / size) ** 2, np.zeros((free.size, free.size))
    unsure = np.abs(axes).T @ errors / (REACH * size)
    down = np.zeros(free.size, dtype=bool)
    if derivatives is not None:
        bend = _bend(point, axes, box, derivatives)
        down = alone + np.diag(bend) < -np.maximum(3.0 * unsure, FLAT)
        # Where errors hide what the residuals' bend adds, or take all away, linear residuals are what is known.
        blind = (unsure > 0.3 * np.maximum(alone, np.abs(np.diag(bend)))) | (alone + np.diag(bend) <= 3.0 * unsure)
        bend[blind], bend[:, blind] = 0.0, 0.0
    bend += np.diag(alone)
    own_bend = np.diag(bend)
    kept = own_bend > FLAT
    scale = np.sqrt(own_bend[kept])
    scaled = bend[np.ix_(kept, kept)] / np.outer(scale, scale)
    eigen, vectors = np.linalg.eigh(scaled) if kept.any() else (np.zeros(0), np.zeros((0, 0)))
    falling = (axes[:, kept] / scale) @ vectors[:, eigen < -10.0 * LEAST]
    return Curvature(axes[:, kept], scaled, scale, np.concatenate([axes[:, down], falling], axis=1), lost)


def _bend(
    point: SearchPoint,
    axes: FloatArray,
    box: tuple[FloatArray, FloatArray],
    derivatives: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """(k, k) Σ r ∇²r over |r|², by differences of the derivatives along each axis; 0 where there is no room."""
    (low, high), x = box, point.x
    rows = []
    for axis in axes.T:
        with np.errstate(divide="ignore", invalid="ignore"):
            up = np.nanmin(np.where(axis > 0, (high - x) / axis, np.where(axis < 0, (low - x) / axis, np.inf)))
            down = np.nanmin(np.where(axis < 0, (x - high) / axis, np.where(axis > 0, (x - low) / axis, np.inf)))
        step = min(REACH, float(up)) if up >= down else -min(REACH, float(down))
        row = np.zeros(axes.shape[1])
        if abs(step) > 0.01 * REACH:
            there = derivatives(np.clip(x + step * axis, low, high))
            if np.isfinite(there).all():
                row = axes.T @ ((there - point.matrix).T @ point.r) / (step * point.cost)
        rows.append(row)
    found = np.array(rows)
    return np.asarray(0.5 * (found + found.T))
