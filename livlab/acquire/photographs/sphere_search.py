"""The search for one round outline in a picture, and the grounds on which a picture is refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from livlab.acquire.photographs.cone import Cone, circle_of, cone_outline, fit_cone, rays, tangents
from livlab.acquire.photographs.outline import FloatArray, circle_path, half_maximum_points, seeds
from livlab.brdf.geometry import Camera
from livlab.errors import InputError

_LEAST_SUPPORT = 0.25
_MOST_FLATTENED = 0.015


@dataclass(frozen=True, eq=False)
class Candidate:
    """A round outline: its cone, edge points, circle (u, v, r), used share of the circumference, contrast."""

    cone: Cone
    points: FloatArray
    circle: tuple[float, float, float]
    support: float
    contrast: float


def candidates(image: FloatArray, camera: Camera, near: tuple[float, float, float] | None) -> list[Candidate]:
    """Round outlines in a picture, likeliest first; only the one about `near` where that is given."""
    starts = [near] if near is not None else seeds(image)
    found: list[Candidate] = []
    noise = _noise(image)
    for start in starts:
        one = _trace(image, camera, start, noise, most=240)
        if one is not None and not any(_same(one, other) for other in found):
            found.append(one)
    # A long edge with much contrast is the sphere; a logo on it or a screw beside it has less of either.
    found.sort(key=lambda x: -x.support * x.circle[2] * np.sqrt(x.contrast))
    for other in found[1:]:
        # A ring of highlights lies inside the limb, however bright it is.
        if other.support > 0.6 and other.contrast > 0.02 * found[0].contrast and _encloses(other, found[0]):
            found.remove(other)
            found.insert(0, other)
    fine = _trace(image, camera, found[0].circle, noise, most=2400) if found else None
    return [fine, *found[1:]] if fine is not None else []


def _same(a: Candidate, b: Candidate) -> bool:
    apart = float(np.hypot(a.circle[0] - b.circle[0], a.circle[1] - b.circle[1]))
    return apart + abs(a.circle[2] - b.circle[2]) < 0.1 * max(a.circle[2], b.circle[2])


def _encloses(a: Candidate, b: Candidate) -> bool:
    return bool(np.hypot(a.circle[0] - b.circle[0], a.circle[1] - b.circle[1]) + b.circle[2] < 1.02 * a.circle[2])


def _trace(
    image: FloatArray, camera: Camera, start: tuple[float, float, float], noise: float, *, most: int
) -> Candidate | None:
    u, v, r = start
    count = int(np.clip(2 * np.pi * r, 90, most))
    path, normals = circle_path(u, v, r, count)
    cone: Cone | None = None
    for reach in (max(5.0, 0.15 * r), max(4.0, 0.04 * r), 4.0):
        points, contrast = half_maximum_points(image, path, normals, reach)
        points = _one_sided(points, contrast, noise)
        if np.isfinite(points[:, 0]).sum() < max(8, _LEAST_SUPPORT * count / 2):
            return None
        try:
            cone = fit_cone(points, camera, tolerance_px=max(0.75, 0.1 * reach))
            path, normals = cone_outline(camera, cone.axis, cone.half_angle, count)
        except InputError:  # points on no cone, or where the lens cannot be inverted: not the sphere
            return None
        if not 0 < cone.half_angle < 1.2:
            return None
        if not np.isfinite(path).all():
            return None
    assert cone is not None
    support = float(cone.used.sum()) / count
    if support < _LEAST_SUPPORT or cone.residual_px > max(1.0, 0.02 * r):
        return None
    circle = circle_of(camera, cone.axis, cone.half_angle)
    level = float(np.median(np.abs(contrast[cone.used])))
    return Candidate(cone, points, circle, support, level)


def _one_sided(points: FloatArray, contrast: FloatArray, noise: float) -> FloatArray:
    """Points whose contrast is clear of the noise and of the sign that most have: a sphere is brighter or darker."""
    size = np.abs(contrast)
    strong = size > max(6 * noise, 0.05 * float(np.nanpercentile(size, 90)) if np.isfinite(size).any() else 0.0)
    sign = np.sign(np.nansum(np.sign(contrast[strong])))
    kept = points.copy()
    kept[~(strong & (np.sign(contrast) == sign))] = np.nan
    return kept


def _noise(image: FloatArray) -> float:
    """Standard deviation of the noise where the picture is flat, from differences of neighbours."""
    middle = image.shape[0] // 2
    tall = max(250_000 // image.shape[1], 1)
    step = np.abs(np.diff(image[max(middle - tall // 2, 0) : middle + tall // 2 + 1], axis=1))
    step = step[np.isfinite(step)]
    return float(1.4826 * np.median(step) / np.sqrt(2)) if step.size else 0.0


def edge_noise(image: FloatArray, found: Candidate) -> float:
    """Scatter (px) that noise gives an edge point: two pixels' noise over the edge's slope, one contrast a pixel."""
    return _noise(image) / np.sqrt(2) / found.contrast if found.contrast > 0 else 0.0


def refuse_second(found: list[Candidate]) -> None:
    """Raise if a second outline stands beside the first and is much like it."""
    first = found[0]
    for other in found[1:]:
        apart = np.hypot(first.circle[0] - other.circle[0], first.circle[1] - other.circle[1])
        beside = apart > 0.7 * (first.circle[2] + other.circle[2])
        alike = other.circle[2] > 0.3 * first.circle[2] and other.contrast > 0.2 * first.contrast
        if beside and alike and other.support > 0.4:
            places = " and ".join(f"({c.circle[0]:.0f}, {c.circle[1]:.0f}) r {c.circle[2]:.0f}" for c in (first, other))
            raise InputError.of(
                "frame", places, "shows two spheres", "cover one, crop, or give near=(u, v, r) of the one that is meant"
            )


def refuse_flattened(image: FloatArray, camera: Camera, cone: Cone) -> None:
    """Raise if the outline is an ellipse about the axis, where a sphere would draw a circle.

    The second harmonic of 1 / radius² over the azimuth is 0 for a sphere under this camera and exact for an ellipse.
    """
    radius = circle_of(camera, cone.axis, cone.half_angle)[2]
    path, normals = cone_outline(camera, cone.axis, cone.half_angle, int(np.clip(2 * np.pi * radius, 90, 720)))
    points, contrast = half_maximum_points(image, path, normals, max(5.0, 0.2 * radius))
    points = _one_sided(points, contrast, _noise(image))
    points = points[np.isfinite(points[:, 0])]
    if len(points) < 20:
        return
    if camera.orthographic:  # a sphere draws a plain circle
        x, y = (points - circle_of(camera, cone.axis, cone.half_angle)[:2]).T
        size = radius
    else:
        d = rays(camera, points)
        e1, e2 = tangents(cone.axis)
        x, y = d @ e1 / (d @ cone.axis), d @ e2 / (d @ cone.axis)
        size = np.tan(cone.half_angle)
    phi = np.arctan2(y, x)
    inverse = size**2 / (x**2 + y**2)
    basis = np.column_stack([np.ones_like(phi), *(f(k * phi) for k in (1, 2) for f in (np.cos, np.sin))])
    weight = np.ones(len(phi))
    for _ in range(30):
        w = np.sqrt(weight)
        a, *_ = np.linalg.lstsq(basis * w[:, None], inverse * w, rcond=None)
        residual = np.abs(inverse - basis @ a)
        spread = max(1.4826 * float(np.median(residual)), 1e-4)
        weight = np.clip(1 - (residual / (4.685 * spread)) ** 2, 0, 1) ** 2
    wave = float(np.hypot(a[3], a[4]))
    used = weight > 0.05
    if not a[0] > wave or used.mean() < 0.5 or used.sum() < 20:
        return
    around = basis[used]
    covariance = spread**2 * 20 * np.linalg.pinv(around.T @ around)  # neighbours err alike
    sd = float(np.sqrt(max(covariance[3, 3], covariance[4, 4])))
    ratio = float(np.sqrt((a[0] - wave) / (a[0] + wave)))
    if 1 - ratio > _MOST_FLATTENED and wave > 5 * sd:
        raise InputError.of(
            "frame",
            f"axis ratio {ratio:.3f}",
            "is an ellipse where this camera would see a sphere as a circle about its axis",
            "check the intrinsics (non-square pixels, a resized or cropped picture), that the body is a sphere, and "
            "that the frame is lit all round (else say kind single)",
        )


def refuse_cut(camera: Camera, best: Candidate) -> None:
    """Raise if part of the outline lies outside the picture."""
    curve, _ = cone_outline(camera, best.cone.axis, best.cone.half_angle, 720)
    beyond = (curve < -0.5) | (curve > np.array([camera.width, camera.height]) - 0.5)
    share = float(np.any(beyond, axis=1).mean())
    if share > 0:
        u, v, r = best.circle
        raise InputError.of(
            "frame",
            f"circle at ({u:.0f}, {v:.0f}) r {r:.0f} px",
            f"is cut by the frame: {share:.0%} of its outline lies outside",
            "move the camera until the whole sphere is in view, or take what is in view: cut = true under [sphere]",
        )


def shaded_limb(image: FloatArray, camera: Camera, cone: Cone) -> float:
    """Share of the limb that is far darker than what lies a sixth of the radius further in."""
    from scipy import ndimage

    r = circle_of(camera, cone.axis, cone.half_angle)[2]
    levels = []
    for part in (1 + 2.5 / r, 1 - 1.5 / r, 0.83):
        curve, _ = cone_outline(camera, cone.axis, cone.half_angle * part, 180)
        levels.append(ndimage.map_coordinates(image, [curve[:, 1], curve[:, 0]], order=1, mode="nearest"))
    beyond, limb, further = levels
    return float(np.mean((limb - beyond) / np.where(further == beyond, np.nan, further - beyond) < 0.6))
