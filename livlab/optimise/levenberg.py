"""Levenberg–Marquardt in a box: the trust region of Moré (1978), with bounds that a step respects as it is made."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from livlab.units import FloatArray

FACTOR = 100.0
"""First radius of the trust region over the size of the parameters (Moré 1978)."""

STEPS = 1000
"""Steps at most."""

LITTLE = 1e-15
"""Share of Σ r² that a step promises, below which there is nothing left to gain."""

LOST = 1e-7
"""Share of its largest length below which a column is lost: its parameter does nothing there, and cannot come back."""

RETREATS = 6
"""Steps that are taken back, at most, because a parameter would be lost."""

Function = Callable[[FloatArray], FloatArray]


def sum_of_squares(r: FloatArray) -> float:
    """Σ r², infinite where it is too large for a number."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(r @ r)


@dataclass
class SearchPoint:
    """Residuals and their derivatives at x; `r` is nan where there are none."""

    x: FloatArray
    r: FloatArray
    matrix: FloatArray

    @property
    def cost(self) -> float:
        """Σ r²."""
        return sum_of_squares(self.r)


@dataclass
class SearchEnd:
    """Where a search ended: the point, how many steps were taken, and the largest length that each column had."""

    point: SearchPoint
    steps: int
    lengths: FloatArray


def levenberg_marquardt(
    residuals: Function,
    matrix: Function,
    start: FloatArray,
    box: tuple[FloatArray, FloatArray],
    sizes: FloatArray,
    *,
    factor: float = FACTOR,
    zero: float = 0.0,
    steps: int = STEPS,
) -> SearchEnd:
    """Minimise Σ r² from a start in a box.

    Parameters
    ----------
    residuals, matrix
        From x to (m,) residuals, not finite where there are none, and to their (m, n) derivatives.
    start, box
        (n,) where it begins, and the bounds.
    sizes
        (n,) sizes of the parameters.
    factor
        First radius of the trust region over the size of the parameters.
    zero
        Σ r² that is as good as none.
    steps
        At most.
    """
    here = SearchPoint(start, residuals(start), matrix(start))
    lengths = column_lengths(here.matrix)
    radius = factor * float(np.linalg.norm(np.where(lengths > 0, lengths, 1.0) * sizes))
    taken = retreats = 0
    while taken < steps and np.isfinite(here.matrix).all() and here.cost > zero:
        scale = np.where(lengths > 0, lengths, 1.0)
        moved, radius = _step(residuals, here, box, scale, radius, first=taken == 0)
        if moved is None:
            break
        moved.matrix = matrix(moved.x)
        found = column_lengths(moved.matrix)
        alive = column_lengths(here.matrix) > LOST * lengths
        there = bool(np.isfinite(moved.matrix).all())
        if not there or (retreats < RETREATS and (alive & ~(found > LOST * lengths)).any()):
            retreats += 1
            radius = 0.2 * float(np.linalg.norm(scale * (moved.x - here.x)))
            if retreats > 4 * RETREATS:
                break
            continue
        taken += 1
        here, lengths = moved, np.maximum(lengths, found)
    return SearchEnd(here, taken, lengths)


def column_lengths(matrix: FloatArray) -> FloatArray:
    """(n,) length of each column, 0 where it is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        found = np.linalg.norm(matrix, axis=0)
    return np.where(np.isfinite(found), found, 0.0)


def _step(
    residuals: Function,
    here: SearchPoint,
    box: tuple[FloatArray, FloatArray],
    scale: FloatArray,
    radius: float,
    *,
    first: bool,
) -> tuple[SearchPoint | None, float]:
    """The next point with a lower cost, and the radius after it; None where there is nothing left to gain."""
    (low, high), cost, n = box, here.cost, here.x.size
    q, upper = np.linalg.qr(here.matrix)
    pulled = q.T @ here.r
    while True:
        step, damping = constrained_step(upper, pulled, low - here.x, high - here.x, scale, radius)
        promised = float(pulled @ pulled) - float(np.sum((pulled + upper @ step) ** 2))
        if not promised > LITTLE * cost or not np.isfinite(step).all():
            return None, radius
        length = float(np.linalg.norm(scale * step))
        radius = min(radius, length) if first else radius
        there = np.clip(here.x + step, low, high)
        r = residuals(there)
        new = sum_of_squares(r) if np.isfinite(r).all() else math.inf
        ratio = (cost - new) / promised
        if ratio <= 0.25:
            slope = float(pulled @ (upper @ step))
            shrink = 0.5 if new <= cost else 0.5 * slope / (slope + 0.5 * (cost - new))
            shrink = 0.1 if not 0.1 <= shrink <= 0.5 or new > 100.0 * cost else shrink
            radius = shrink * min(radius, length / 0.1)
        elif ratio >= 0.75 or damping == 0.0:
            radius = 2.0 * length
        if ratio >= 1e-4:
            return SearchPoint(there, r, np.zeros((r.size, n))), radius
        if radius <= 1e-16 * float(np.linalg.norm(scale * here.x)) or np.array_equal(there, here.x):
            return None, radius


def constrained_step(
    upper: FloatArray, pulled: FloatArray, low: FloatArray, high: FloatArray, scale: FloatArray, radius: float
) -> tuple[FloatArray, float]:
    """The step that minimises |pulled + upper δ|² with low ≤ δ ≤ high, damped so that |scale δ| ≤ radius.

    A parameter on a bound that the slope pushes against stays there; if others meet theirs on the way, the damped
    problem is solved within the box.

    Returns
    -------
    step, damping
        λ of the penalty λ |scale δ|²; 0 for a step of Gauss and Newton.
    """
    slope = upper.T @ pulled
    free = ~(((low >= 0.0) & (slope >= 0.0)) | ((high <= 0.0) & (slope <= 0.0)))
    step = np.zeros(slope.size)
    if not free.any():
        return step, 0.0
    step[free], damping = _damped(upper[:, free] / scale[free], pulled, radius)
    step[free] /= scale[free]
    if (step >= low).all() and (step <= high).all():
        return step, damping
    from scipy.optimize import lsq_linear

    root = math.sqrt(damping) if damping > 0 else 1e-12 * float(np.abs(upper / scale).max())
    matrix = np.concatenate([upper[:, free] / scale[free], root * np.eye(int(free.sum()))])
    wanted = np.concatenate([-pulled, np.zeros(int(free.sum()))])
    box = (low[free] * scale[free], np.maximum(high[free], np.nextafter(low[free], np.inf)) * scale[free])
    step[free] = lsq_linear(matrix, wanted, box, method="bvls").x / scale[free]
    return np.clip(step, low, high), damping


def _damped(matrix: FloatArray, pulled: FloatArray, radius: float) -> tuple[FloatArray, float]:
    """The least |pulled + matrix δ|² with |δ| ≤ radius, within a tenth, by the secular equation (Moré 1978)."""
    left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
    parts = left.T @ pulled
    kept = sizes > 1e-15 * max(float(sizes.max(initial=0.0)), 1e-300)
    parts, sizes, right = parts[kept], sizes[kept], right[kept]

    def at(damping: float) -> FloatArray:
        return -sizes * parts / (sizes**2 + damping)

    if float(np.linalg.norm(at(0.0))) <= 1.1 * radius:
        return right.T @ at(0.0), 0.0
    below, above = 0.0, float(np.linalg.norm(sizes * parts)) / radius
    damping = 1e-3 * above
    for _ in range(60):
        step = at(damping)
        length = float(np.linalg.norm(step))
        if abs(length - radius) <= 0.1 * radius:
            break
        below, above = (damping, above) if length > radius else (below, damping)
        # Newton's method on 1/length, which is nearly straight.
        turn = float(np.sum(step**2 / (sizes**2 + damping)))
        damping += length**2 / turn * (length - radius) / radius
        if not below < damping < above:
            damping = max(1e-3 * above, math.sqrt(below * above))
    return right.T @ at(damping), damping
