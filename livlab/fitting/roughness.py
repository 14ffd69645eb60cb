"""How rough a curve is from point to point, and whether residuals are smoother than noise.

Noise is told without a model by what each point differs from the straight line through its neighbours (Gasser, Sroka
& Jennen-Steinmetz 1986); a model that misses leaves residuals that are large for their roughness, which is von
Neumann's ratio (1941), whose chance is that of a ratio of quadratic forms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from livlab.optimise.structure import Structure
from livlab.units import FloatArray

WAVES = 6
"""Slow waves of a curve at most: its mean and half a period up to two and a half."""

SLOW = "wavelength (slow waves)"
"""Name of their test."""

Series = Sequence[tuple[slice, FloatArray]]
"""Curves among residuals: their place, and the wavelength of each point."""


def roughness(x: ArrayLike) -> FloatArray:
    """(n, n) matrix A with E[eᵀAe] = σ² tr A of independent noise, and eᵀAe = 0 of a straight line.

    Σ over inner points of (a e₋ + b e₊ − e)²/(a² + b² + 1), with a, b the weights of the straight line through the
    neighbours (Gasser et al. 1986, eq. 2.1).

    >>> A = roughness([0.0, 1.0, 3.0, 4.0])
    >>> bool(abs(A @ [1.0, 2.0, 4.0, 5.0]).max() < 1e-12), round(float(A.trace()), 12)
    (True, 2.0)
    """
    t = np.asarray(x, dtype=np.float64)
    return _quadratic(_bends(t))


def _quadratic(rows: FloatArray) -> FloatArray:
    return np.asarray(rows.T @ rows)


def _bends(t: FloatArray) -> FloatArray:
    """(n − 2, n) each inner point's difference from its neighbours' line, of variance σ²."""
    order = np.argsort(t)
    made = np.zeros((max(len(t) - 2, 0), len(t)))
    for row, (low, mid, high) in zip(made, zip(order, order[1:], order[2:], strict=False), strict=True):
        wide = t[high] - t[low]
        a = float((t[high] - t[mid]) / wide) if wide > 0 else 0.5
        size = math.sqrt(a * a + (1.0 - a) ** 2 + 1.0)
        row[[low, mid, high]] = np.array([a, -1.0, 1.0 - a]) / size
    return made


def noise_of(
    e: FloatArray, x: FloatArray, level: FloatArray, project: FloatArray, beside: FloatArray, floor: float
) -> FloatArray:
    """(n,) variance of each point by the residuals' roughness: one for all, or a share of the level squared.

    Which of the two is decided by the likelihood of the differences.

    Parameters
    ----------
    e, x, level
        (n,) residuals, wavelengths, and the curve's size.
    project
        (n, n) what takes the fitted directions out.
    beside
        (n, n) covariance of other errors in e.
    floor
        Least variance.
    """
    bends, best = _bends(x), (-math.inf, np.full(len(e), floor))
    for shape in (np.ones(len(e)), (level / math.sqrt(float(np.mean(level**2)))) ** 2):
        unit = np.maximum(shape, 1e-4)
        scaled = bends / np.sqrt(unit)
        rough = _quadratic(scaled)
        one = float(np.trace(project @ rough @ project @ np.diag(unit)))
        variance = max((float(e @ rough @ e) - float(np.sum(rough * beside))) / one, floor)
        likely = -0.5 * float(np.sum(np.log(unit))) - 0.5 * len(e) * math.log(max(float(e @ rough @ e), 1e-300))
        if likely > best[0]:
            best = likely, variance * unit
    return best[1]


def ratio_p(z: FloatArray, jacobian: FloatArray, series: Series) -> float:
    """Chance of residuals as large for their roughness, if they are independent and of one size.

    zᵀz/zᵀAz of the z without its part along the fitted directions: P(zᵀ(1 − tA)z > 0) of a normal z, by the
    saddlepoint (Lugannani & Rice 1980), whose relative error is a few per cent.
    """
    project = _project(jacobian, len(z))
    rough = np.zeros((len(z), len(z)))
    for at, x in series:
        rough[at, at] = roughness(x)
    r = project @ z
    under = float(r @ rough @ r)
    if under <= 0.0:
        return math.nan
    t = float(r @ r) / under
    eigen = np.linalg.eigvalsh(project @ (np.eye(len(z)) - t * rough) @ project)
    eigen = eigen[np.abs(eigen) > 1e-10 * np.abs(eigen).max()]
    return beyond_zero(eigen)


def beyond_zero(weights: FloatArray) -> float:
    """P(Σ wₖ χₖ² > 0) of independent χ² with one degree of freedom each.

    >>> round(beyond_zero(np.array([1.0, -1.0, 1.0, -1.0])), 6)
    0.5
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    if weights.size == 0 or weights.min() >= 0:
        return 1.0
    if weights.max() <= 0:
        return 0.0

    def slope(s: float) -> float:
        return float(np.sum(weights / (1.0 - 2.0 * s * weights)))

    low, high = 0.5 / weights.min(), 0.5 / weights.max()
    s = float(brentq(slope, low * (1 - 1e-12), high * (1 - 1e-12), xtol=1e-15 * (high - low), rtol=1e-14))
    bend = float(np.sum(2.0 * (weights / (1.0 - 2.0 * s * weights)) ** 2))
    u = s * math.sqrt(bend)
    if abs(u) < 1e-5:  # the limit at the mean
        skew = float(np.sum(8.0 * (weights / (1.0 - 2.0 * s * weights)) ** 3)) / bend**1.5
        return float(0.5 - skew / (6.0 * math.sqrt(2.0 * math.pi)))
    w = math.copysign(math.sqrt(max(float(np.sum(np.log(1.0 - 2.0 * s * weights))), 0.0)), s)
    return float(np.clip(ndtr(-(w + math.log(u / w) / w)), 0.0, 1.0))


def slow_waves(z: FloatArray, jacobian: FloatArray, series: Series) -> Structure:
    """χ² of the residuals' slowest waves along the wavelength (Neyman's smooth test, 1937), noise known.

    A model that misses does so smoothly, and what is spread thin over all of χ² stands together here.
    """
    from scipy.special import gammaincc

    rows = []
    for at, x in series:
        n = len(x)
        turn = np.argsort(np.argsort(x)) + 0.5
        for k in range(min(WAVES, n // 4)):
            rows.append(np.zeros(len(z)))
            rows[-1][at] = np.cos(np.pi * k * turn / n)
    if not rows:
        return Structure(SLOW, math.nan)
    waves = np.array(rows) / np.linalg.norm(np.array(rows), axis=1, keepdims=True)
    _, size, q = np.linalg.svd(waves @ _project(jacobian, len(z)), full_matrices=False)
    q = q[size > 1e-3]
    chi2 = float(np.sum((q @ z) ** 2))
    p = float(gammaincc(0.5 * len(q), 0.5 * chi2)) if len(q) else math.nan
    ratio = math.sqrt(chi2 / len(q)) if len(q) else math.nan
    return Structure(SLOW, p, ratio=ratio, dof=len(q))


def _project(rows: FloatArray, n: int) -> FloatArray:
    """(n, n) projector that takes the rows' directions out."""
    length = np.linalg.norm(rows, axis=1)
    rows = rows[length > 0] / length[length > 0, None]
    if not len(rows):
        return np.eye(n)
    _, size, q = np.linalg.svd(rows, full_matrices=False)
    q = q[size > 1e-6 * size.max()]
    return np.asarray(np.eye(n) - q.T @ q)
