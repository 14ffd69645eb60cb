"""Cone of the rays that graze a sphere.

A ray d grazes a sphere whose centre lies along c (unit) at distance D where d.c = cos(beta), sin(beta) = R / D. With
q = c / cos(beta) that is d.q = 1, linear in q: no ellipse need be fitted, and the outline's own centre, which is not
the projected centre of the sphere, is never used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.acquire.photographs.outline import FloatArray
from livlab.brdf.geometry import Camera
from livlab.errors import InputError


@dataclass(frozen=True, eq=False)
class Cone:
    """A cone of grazing rays: unit axis, half angle (rad), (3, 3) covariance of two tilts and the half angle (rad²).

    For an orthographic camera the "rays" are picture points lifted to the unit sphere by the inverse stereographic
    projection, which turns circles into cones.

    `ellipse_px` is the amplitude of what goes twice round in the residual, as of an ellipse, and `chance` that of such
    an amplitude by the scatter of the points.
    """

    axis: FloatArray
    half_angle: float
    covariance: FloatArray
    residual_px: float
    used: NDArray[np.bool_]
    ellipse_px: float = 0.0
    chance: float = 1.0


def rays(camera: Camera, points: ArrayLike) -> FloatArray:
    """Unit directions (n, 3), camera frame, of picture points (n, 2); lifted points for an orthographic camera."""
    uv = np.atleast_2d(np.asarray(points, dtype=np.float64))
    if camera.orthographic:
        scale, middle = _lift(camera)
        xy = (uv - middle) / scale
        square = np.sum(xy**2, axis=1)
        return np.asarray(np.column_stack([2 * xy, 1 - square]) / (1 + square)[:, None], dtype=np.float64)
    _, towards = camera.rays(uv[:, 0], uv[:, 1])
    return np.asarray(towards @ camera.rotation.T)


def pixels(camera: Camera, directions: FloatArray) -> FloatArray:
    """Picture points (n, 2) of directions in the camera frame: the inverse of `rays`."""
    if camera.orthographic:
        scale, middle = _lift(camera)
        return np.asarray(middle + scale * directions[:, :2] / (1 + directions[:, 2:]))
    return camera.project((directions - camera.translation) @ camera.rotation)


def _lift(camera: Camera) -> tuple[float, FloatArray]:
    return 2.0 * max(camera.width, camera.height), np.array([camera.width - 1, camera.height - 1]) / 2


def tangents(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors across an axis and each other."""
    e1 = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(axis, e1)


def cone_outline(camera: Camera, axis: FloatArray, half_angle: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Picture points (count, 2) of a cone and the outward normals of the curve they draw."""
    e1, e2 = tangents(axis)
    phi = np.linspace(0.0, 2 * np.pi, count, endpoint=False)[:, None]
    around = np.cos(phi) * e1 + np.sin(phi) * e2
    curve = pixels(camera, np.cos(half_angle) * axis + np.sin(half_angle) * around)
    tangent = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    outward = np.sum(normals * (curve - curve.mean(axis=0)), axis=1) > 0
    return curve, np.where(outward[:, None], normals, -normals)


def circle_of(camera: Camera, axis: FloatArray, half_angle: float) -> tuple[float, float, float]:
    """Middle (u, v) and mean radius of the curve that a cone draws: weighted by arc length, exact for a circle."""
    if camera.orthographic:
        scale, middle = _lift(camera)
        q = axis / np.cos(half_angle)
        at = q[:2] / (1 + q[2])
        radius = np.sqrt((q[2] - 1) / (1 + q[2]) + at @ at)
        u, v = middle + scale * at
        return float(u), float(v), float(scale * radius)
    curve, _ = cone_outline(camera, axis, half_angle, 360)
    length = np.linalg.norm(np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0), axis=1)
    u, v = np.average(curve, axis=0, weights=length)
    return float(u), float(v), float(np.average(np.hypot(curve[:, 0] - u, curve[:, 1] - v), weights=length))


def fit_cone(points: ArrayLike, camera: Camera, *, tolerance_px: float = 1.0, seed: int = 0) -> Cone:
    """Cone of grazing rays through edge points: d.q = 1, robust, weighted to distances in the picture.

    Three points give a cone; the triple with most points within `tolerance_px` is kept (RANSAC, Fischler & Bolles
    1981), then weighted least squares with Tukey's biweight. The covariance takes the scatter of the points and
    the length over which neighbours err alike.

    Parameters
    ----------
    points : (n, 2) array
        Edge points (u, v) in order along the outline; NaN rows are skipped.

    Raises
    ------
    InputError
        Fewer than eight points, or no cone through them.
    """
    uv = np.asarray(points, dtype=np.float64)
    finite = np.all(np.isfinite(uv), axis=1)
    if finite.sum() < 8:
        raise InputError.of("outline", int(finite.sum()), "needs eight edge points at least", "see that it is visible")
    kept = uv[finite]
    d = rays(camera, kept)
    q = _ransac(d, kept, camera, tolerance_px, np.random.default_rng(seed))
    if q is None:
        raise InputError.of(
            "outline", len(d), "edge points that lie on no cone", "see that the whole sphere is in view"
        )
    axis, beta = _axis_angle(q)
    weight, px_per_rad, residual = np.ones(len(d)), np.ones(len(d)), np.zeros(len(d))
    spread = tolerance_px
    for turn in range(30):
        if turn < 2:  # it hardly changes with the axis
            px_per_rad = _scale(camera, kept, d, axis)
        residual = (_angle(d, axis) - beta) * px_per_rad
        near = np.abs(residual) < 3 * max(spread, 1e-3)
        spread = max(1.4826 * float(np.median(np.abs(residual[near]))) if near.any() else spread, 1e-6)
        weight = np.clip(1 - (residual / (4.685 * max(spread, 0.02))) ** 2, 0, None) ** 2
        w = np.sqrt(weight) * px_per_rad
        q = np.asarray(np.linalg.lstsq(d * w[:, None], w, rcond=None)[0], dtype=np.float64)
        before = (axis, beta)
        axis, beta = _axis_angle(q)
        if np.abs(axis - before[0]).max() + abs(beta - before[1]) < 1e-12:
            break
    used_here = weight > 0.05
    rms = float(np.sqrt(np.mean(residual[used_here] ** 2)))
    e1, e2 = tangents(axis)
    across = d[used_here] - (d[used_here] @ axis)[:, None] * axis
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    jacobian = -px_per_rad[used_here, None] * np.column_stack([across @ e1, across @ e2, np.ones(len(across))])
    variance = rms**2 * _correlation_length(residual[used_here]) * len(across) / max(len(across) - 3, 1)
    covariance = np.asarray(variance * np.linalg.pinv(jacobian.T @ jacobian), dtype=np.float64)
    used = np.zeros(len(uv), dtype=bool)
    used[np.flatnonzero(finite)[used_here]] = True
    ellipse, chance = _ellipse(np.arctan2(across @ e2, across @ e1), residual[used_here])
    return Cone(axis, beta, covariance, rms, used, ellipse, chance)


def _ellipse(angle: FloatArray, residual: FloatArray) -> tuple[float, float]:
    """Amplitude of the residual's second harmonic, and the chance of it: exp(-A² n / 4 s²) of n independent points.

    The scatter s is what is left beside it, and n the points over the length on which neighbours err alike.
    """
    basis = np.column_stack([np.cos(2 * angle), np.sin(2 * angle)])
    found = np.linalg.lstsq(basis, residual, rcond=None)[0]
    left = residual - basis @ found
    amplitude = float(np.hypot(*found))
    independent = len(residual) / max(_correlation_length(left), 1.0)
    spread = max(float(np.mean(left**2)), 1e-300)
    return amplitude, float(np.exp(-min(amplitude**2 * independent / (4 * spread), 700.0)))


def _axis_angle(q: FloatArray) -> tuple[FloatArray, float]:
    length = float(np.linalg.norm(q))
    return q / length, float(np.arccos(np.clip(1 / length, -1, 1)))


def _angle(d: FloatArray, axis: FloatArray) -> FloatArray:
    # The arcsine of the cross product keeps its digits where the arccosine of a number near 1 has none.
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(d, axis), axis=1), d @ axis))


def _scale(camera: Camera, uv: FloatArray, d: FloatArray, axis: FloatArray) -> FloatArray:
    """Pixels per radian away from the axis, at each point."""
    away = d - (d @ axis)[:, None] * axis
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    step = 1e-4
    moved = pixels(camera, d * np.cos(step) + np.sin(step) * away)
    back = pixels(camera, d * np.cos(step) - np.sin(step) * away)
    return np.asarray(np.linalg.norm(moved - back, axis=1) / (2 * step))


def _ransac(
    d: FloatArray, uv: FloatArray, camera: Camera, tolerance_px: float, rng: np.random.Generator, trials: int = 400
) -> FloatArray | None:
    matrices = d[rng.integers(0, len(d), size=(trials, 3))]  # a point drawn twice gives a singular matrix
    good = np.abs(np.linalg.det(matrices)) > 1e-12
    if not good.any():
        return None
    q = np.linalg.solve(matrices[good], np.ones((int(good.sum()), 3, 1)))[..., 0]
    length = np.linalg.norm(q, axis=1)
    q = q[(length > 1) & np.isfinite(length)]
    if not len(q):
        return None
    middle = d.mean(axis=0) / np.linalg.norm(d.mean(axis=0))
    px_per_rad = float(np.median(_scale(camera, uv, d, middle)))
    length = np.linalg.norm(q, axis=1)
    angle = np.arccos(np.clip(d @ (q / length[:, None]).T, -1, 1)) - np.arccos(1 / length)
    hits = np.sum(np.abs(angle) * px_per_rad < tolerance_px, axis=0)
    return np.asarray(q[int(np.argmax(hits))])


def _correlation_length(residual: FloatArray) -> float:
    """How many neighbours err alike: 1 + 2 times the sum of the autocorrelations up to the first that is not > 0."""
    x = residual - residual.mean()
    power = float(np.mean(x**2))
    if power == 0:
        return 1.0
    total = 1.0
    for lag in range(1, min(60, len(x) // 4)):
        rho = float(np.mean(x[lag:] * x[:-lag])) / power
        if rho <= 0.05:
            break
        total += 2 * rho
    return total
