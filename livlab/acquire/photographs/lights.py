"""Where the lights stand, from the highlights that they leave on mirror balls.

A mirror turns the eye's direction v about the normal n to l = 2 (n.v) n - v. Errors of a pixel double on the way: at a
radius of R px one pixel is about 2 / R rad in the middle of the ball and more towards its limb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.acquire.photographs.outline import FloatArray, grey
from livlab.acquire.photographs.pose import SpherePose
from livlab.brdf.geometry import Camera, Sphere
from livlab.errors import InputError

GRAZING_PX = 0.8
"""Least (1 - sin θ_o) R_px: nearer to the limb a pixel spans too many directions."""

_SHAPE_SHARE = 0.1
"""Share of a blob's rms radius by which its centroid may miss the source's middle: flare, a clipped core."""


@dataclass(frozen=True, eq=False)
class Highlight:
    """A light as one mirror ball shows it.

    Attributes
    ----------
    direction
        Unit vector (3,) from the ball to the light, world frame.
    origin_mm
        Point (3,) on the ball where it was seen.
    covariance
        (3, 3) of the direction, of unit length squared: highlight and pose.
    pixel, pixel_sd
        Centroid (u, v), and its standard uncertainty, px.
    area_px
        Pixels above half of the highest level.
    solid_angle_sr
        What those pixels span in directions: an upper bound of the source's, since flare and blur widen it.
    saturated
        Share of those pixels that are clipped.
    notes
        What a reader should know.
    """

    direction: FloatArray
    origin_mm: FloatArray
    covariance: FloatArray
    pixel: tuple[float, float]
    pixel_sd: float
    area_px: float
    solid_angle_sr: float
    saturated: float
    notes: tuple[str, ...] = ()

    @property
    def sd_rad(self) -> float:
        """Standard uncertainty of the direction, rad, in the worse of its two tilts."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))


def mirror_highlight(
    image: ArrayLike, camera: Camera, pose: SpherePose, *, saturation: float | None = None, name: str = "image"
) -> Highlight:
    """Direction of the light whose highlight a mirror ball shows.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, channels) array
        Linear values; clipped ones as they are.
    camera, pose
        The camera and where the ball stands.
    saturation : float, optional
        Level at which values clip; None: the picture's highest value where more than two pixels hold it.
    name : str
        What messages call it.

    Raises
    ------
    InputError
        No highlight on the ball, two of like strength, or one too near the limb.
    """
    values = np.nan_to_num(grey(np.asarray(image)), nan=0.0)
    if values.shape != (camera.height, camera.width):
        raise InputError.of(
            name, values.shape, f"must be {camera.height} x {camera.width}", "Use the camera's pictures."
        )
    rows, columns = _on_ball(camera, pose.sphere)
    level = values[rows, columns]
    ground, peak = float(np.median(level)), float(level.max())
    spread = 1.4826 * float(np.median(np.abs(level - ground)))
    if not peak > ground + max(10 * spread, 1e-12):
        raise InputError.of(
            name, f"peak {peak:.4g}, ground {ground:.4g}", "shows no highlight on the mirror ball", _SEE
        )
    blob, others = _blob(values, rows, columns, ground, peak)
    weight = np.clip(values[blob] - ground, 0, None)
    core = values[blob] > ground + 0.5 * (peak - ground)
    area = int(core.sum())
    v, u = (float(np.average(axis, weights=weight)) for axis in blob)
    notes = []
    if others > 0.2:
        raise InputError.of(
            name,
            f"a second highlight with {others:.0%} of the first's light",
            "must show one light only",
            "Switch the other lights off, cover windows, or give near lights a ball each.",
        )
    clip = peak if saturation is None else saturation
    at_top = float(np.mean(values[blob][core] >= clip * 0.999))
    if saturation is None and np.count_nonzero(values[blob] >= clip) <= 2:
        at_top = 0.0
    radius = float(np.sqrt(np.average((blob[1] - u) ** 2 + (blob[0] - v) ** 2, weights=weight)))
    noise = spread * radius * np.sqrt(len(weight)) / weight.sum()
    sd = float(np.hypot(noise, 0.3 * _SHAPE_SHARE * radius + 0.05))
    if at_top > 0:
        # Of a clipped pixel it is not known how much of it the highlight covers.
        sd = float(np.hypot(_SHAPE_SHARE * radius, 0.5 / np.sqrt(area)))
        notes.append(f"{at_top:.0%} of the highlight is clipped: its middle is the middle of its outline.")
    if area < 4:
        notes.append(f"The highlight has {area} pixels: its centroid follows the pixel grid.")
    direction, origin, cos_o = _mirror(camera, pose.sphere, u, v)
    if (1 - np.sqrt(1 - cos_o**2)) * pose.circle_px[2] < GRAZING_PX:
        raise InputError.of(
            name, f"highlight at ({u:.1f}, {v:.1f}) px", "lies too near the limb of the ball", "Turn camera or light."
        )
    covariance, stretch = _covariance(camera, pose, u, v, sd)
    return Highlight(
        direction,
        origin,
        covariance,
        pixel=(u, v),
        pixel_sd=sd,
        area_px=float(area),
        solid_angle_sr=area * stretch,
        saturated=at_top,
        notes=tuple(notes),
    )


_SEE = "See that the light was on and the ball is the mirror, and give its outline or mask."


def _on_ball(camera: Camera, sphere: Sphere) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    curve = sphere.outline(camera)
    low = np.clip(np.floor(curve.min(axis=0)), 0, None).astype(int)
    high = np.minimum(np.ceil(curve.max(axis=0)).astype(int) + 1, [camera.width, camera.height])
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    origins, towards = camera.rays(columns, rows)
    hits = sphere.meet(origins, towards)
    cosine = -np.einsum("...i,...i->...", hits.normals, towards)
    keep = hits.hit & (cosine > 0.1)
    return rows[keep], columns[keep]


def _blob(
    values: FloatArray, rows: NDArray[np.intp], columns: NDArray[np.intp], ground: float, peak: float
) -> tuple[tuple[NDArray[np.intp], NDArray[np.intp]], float]:
    """Pixels of the strongest patch above half of the peak, and the light of the next strongest relative to it."""
    from scipy import ndimage

    bright = np.zeros(values.shape, dtype=bool)
    bright[rows, columns] = values[rows, columns] > ground + 0.5 * (peak - ground)
    patches, count = ndimage.label(bright, structure=np.ones((3, 3)))
    light = ndimage.sum_labels(values - ground, patches, np.arange(1, count + 1))
    order = np.argsort(light)[::-1]
    # Two more pixels around: a small highlight has much of its light in pixels that it covers in part.
    where = np.nonzero(ndimage.binary_dilation(patches == order[0] + 1, iterations=2))
    return (where[0], where[1]), float(light[order[1]] / light[order[0]]) if count > 1 else 0.0


def _mirror(camera: Camera, sphere: Sphere, u: float, v: float) -> tuple[FloatArray, FloatArray, float]:
    origin, towards = camera.rays(u, v)
    hit = sphere.meet(origin, towards)
    cosine = -float(hit.normals @ towards)
    direction = towards + 2 * cosine * hit.normals
    return direction / np.linalg.norm(direction), hit.points_mm, cosine


def _covariance(camera: Camera, pose: SpherePose, u: float, v: float, sd_px: float) -> tuple[FloatArray, float]:
    """Covariance of the direction, and the solid angle that a pixel spans."""
    h = 1e-3
    by_pixel = np.column_stack(
        [
            (_mirror(camera, pose.sphere, u + a, v + b)[0] - _mirror(camera, pose.sphere, u - a, v - b)[0]) / (2 * h)
            for a, b in ((h, 0.0), (0.0, h))
        ]
    )
    step = 1e-5 * pose.sphere.radius_mm
    by_pose = []
    for k in range(4):
        moved = [
            Sphere(
                pose.sphere.centre_mm + sign * step * np.eye(4)[k, :3],
                pose.sphere.radius_mm + sign * step * float(k == 3),
            )
            for sign in (1, -1)
        ]
        by_pose.append((_mirror(camera, moved[0], u, v)[0] - _mirror(camera, moved[1], u, v)[0]) / (2 * step))
    jacobian = np.column_stack(by_pose)
    covariance = sd_px**2 * by_pixel @ by_pixel.T + jacobian @ pose.covariance @ jacobian.T
    return np.asarray(covariance), float(np.linalg.norm(np.cross(by_pixel[:, 0], by_pixel[:, 1])))


@dataclass(frozen=True, eq=False)
class NearLight:
    """A near light from two or more balls.

    Attributes
    ----------
    position_mm, covariance
        Where the rays from the balls meet (3,), and its (3, 3) covariance, mm².
    miss_mm
        Root mean square distance of the rays from it.
    distance_mm
        From the mean of the balls.
    """

    position_mm: FloatArray
    covariance: FloatArray
    miss_mm: float
    distance_mm: float


def near_position(highlights: Sequence[Highlight]) -> NearLight:
    """Where a light stands that two or more mirror balls show: the point nearest to their rays.

    Minimises the squared distances from the rays, each weighted with 1 / (distance times the direction's uncertainty)²
    along its two tilts.

    Raises
    ------
    InputError
        Fewer than two balls, or rays so nearly parallel that the distance is not known to a third: a distant light.
    """
    if len(highlights) < 2:
        raise InputError.of("highlights", len(highlights), "needs two balls at least", "Add a ball, or say distant.")
    rays = [(h.origin_mm, h.direction) for h in highlights]
    across = [np.eye(3) - np.outer(d, d) for _, d in rays]
    weights = list(across)
    middle = np.mean([p for p, _ in rays], axis=0)
    at = middle
    normal = np.eye(3)
    for _ in range(6):
        normal = np.sum(weights, axis=0)
        if np.linalg.cond(normal) > 1e14:
            break
        at = np.linalg.solve(normal, np.sum([w @ p for w, (p, _) in zip(weights, rays, strict=True)], axis=0))
        weights = []
        for h, a in zip(highlights, across, strict=True):
            far = max(float(np.linalg.norm(at - h.origin_mm)), 1e-9)
            weights.append(a @ np.linalg.pinv(far**2 * a @ (h.covariance + 1e-12 * np.eye(3)) @ a) @ a)
    covariance = np.asarray(np.linalg.pinv(normal), dtype=np.float64)
    distance = float(np.linalg.norm(at - middle))
    along = (at - middle) / max(distance, 1e-12)
    told = float(np.sqrt(along @ covariance @ along))
    backwards = any(float((at - p) @ d) <= 0 for p, d in rays)
    if backwards or told > distance / 3:
        raise InputError.of(
            "highlights",
            f"{distance:.4g} +- {told:.2g} mm" if not backwards else "rays that part",
            "rays too nearly parallel to give a distance",
            "Take the light as distant, move the balls further apart, or use larger balls in the picture.",
        )
    miss = np.sqrt(np.mean([float(np.sum((a @ (at - p)) ** 2)) for a, (p, _) in zip(across, rays, strict=True)]))
    return NearLight(at, covariance, float(miss), distance)


def distant_direction(highlights: Sequence[Highlight]) -> tuple[FloatArray, FloatArray]:
    """Mean direction (3,) of a distant light over balls, weighted by their uncertainty, and its (3, 3) covariance.

    Raises
    ------
    InputError
        No ball.
    """
    if not highlights:
        raise InputError.of("highlights", 0, "needs one ball at least", "Give a picture of a mirror ball.")
    # The unit length is no measurement: a little is added along the direction so that each can be inverted.
    inverse = [np.linalg.inv(h.covariance + np.outer(h.direction, h.direction) * h.sd_rad**2) for h in highlights]
    covariance = np.linalg.inv(np.sum(inverse, axis=0))
    mean = covariance @ np.sum([w @ h.direction for w, h in zip(inverse, highlights, strict=True)], axis=0)
    mean /= np.linalg.norm(mean)
    flat = np.eye(3) - np.outer(mean, mean)
    return mean, flat @ covariance @ flat


def lambert_intensities(
    values: FloatArray, cosines: FloatArray, *, least_cosine: float = 0.26
) -> tuple[FloatArray, FloatArray]:
    """Relative intensity of each light, and its standard error, from a matte sphere of one reflectance.

    Least squares of value = intensity · cosine, light by light; scaled so that the mean is 1.

    Parameters
    ----------
    values : (lights, pixels[, channels]) array
        Linear; NaN where not usable.
    cosines : (lights, pixels) array
        n.l, times the scale of a near light.
    least_cosine : float
        Pixels lit more obliquely (75°) are left out.
    """
    v = values if values.ndim == 3 else values[..., None]
    use = np.isfinite(v) & (cosines >= least_cosine)[..., None]
    c = np.where(use, cosines[..., None], 0.0)
    x = np.where(use, v, 0.0)
    power = np.sum(c**2, axis=1)
    intensity = np.sum(c * x, axis=1) / power
    residual = np.where(use, x - c * intensity[:, None], 0.0)
    count = np.maximum(use.sum(axis=1) - 1, 1)
    error = np.sqrt(np.sum(residual**2, axis=1) / count / power)
    mean = intensity.mean(axis=0)
    return np.asarray(intensity / mean), np.asarray(error / mean)
