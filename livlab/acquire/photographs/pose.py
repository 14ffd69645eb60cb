"""Where a sphere stands, from its outline in a picture.

Edge points where the brightness is half way between both sides, through the camera's intrinsics and lens distortion,
on the cone of rays that graze a sphere (`livlab.acquire.photographs.cone`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from livlab.acquire.photographs.cone import circle_of, cone_outline, fit_cone, tangents
from livlab.acquire.photographs.outline import FloatArray, circle_path, grey, seeds
from livlab.acquire.photographs.sphere_search import (
    Candidate,
    candidates,
    edge_noise,
    refuse_cut,
    refuse_flattened,
    refuse_second,
    shaded_limb,
)
from livlab.brdf.geometry import Camera, Sphere
from livlab.errors import InputError

Kind = Literal["all-round", "silhouette", "single"]

SYSTEMATIC_PX: dict[str, tuple[float, float]] = {
    "all-round": (0.02, 0.06),
    "silhouette": (0.02, 0.02),
    "single": (0.27, 0.45),
}
"""Standard uncertainty of centre and radius that shading leaves, px, by the kind of frame: a single light shades the
limb and draws the edge inwards (by 0.45 px where it stands beside the camera and R is 115 px), a ring of lights
hardly, a back-lit silhouette not at all."""


@dataclass(frozen=True, eq=False)
class SpherePose:
    """A sphere found in a picture.

    Attributes
    ----------
    sphere
        Centre (mm, world) and radius (mm).
    covariance
        (4, 4) of centre x, y, z and radius, mm²: scatter of the edge points, systematic part and `radius_sd_mm`.
    circle_px
        Middle (u, v) and mean radius of the outline; what a circle drawn over the picture needs.
    circle_sd_px
        Standard uncertainty of these, systematic part included.
    systematic_px
        The systematic part alone, of centre and radius.
    residual_px
        Root mean square distance of the used edge points from the outline.
    ellipse_px, chance
        How far the edge points lie off the outline as an ellipse would, and the chance of that by their scatter.
    noise_px
        Scatter of the edge points that the picture's noise lets expect, px.
    support
        Share of the outline's circumference on which edge points were found and used.
    points
        (n, 2) used edge points.
    outline
        (m, 2) the fitted outline, closed, for drawing.
    kind
        The kind of frame.
    notes
        What a reader should know.
    """

    sphere: Sphere
    covariance: FloatArray
    circle_px: tuple[float, float, float]
    circle_sd_px: tuple[float, float, float]
    systematic_px: tuple[float, float]
    residual_px: float
    support: float
    points: FloatArray
    outline: FloatArray
    kind: Kind
    notes: tuple[str, ...] = field(default=())
    ellipse_px: float = 0.0
    chance: float = 1.0
    noise_px: float = 0.0

    @property
    def told(self) -> str:
        """The misfit of the outline in words."""
        text = f"edge points {self.residual_px:.2f} px off"
        if self.noise_px > 1e-3:
            text += f", {self.residual_px / self.noise_px:.2g} x the noise"
        return f"{text}; elliptic by {self.ellipse_px:.2f} px (chance {self.chance:.1g})"


def all_round(frames: Iterable[ArrayLike]) -> FloatArray:
    """Maximum over frames under many lights, pixel by pixel: the limb is bright all round. NaN where all are NaN."""
    most: FloatArray | None = None
    for frame in frames:
        array = grey(np.asarray(frame))
        most = array.copy() if most is None else np.fmax(most, array)
    if most is None:
        raise InputError.of("frames", 0, "must hold one frame at least", "give the pictures of the sphere")
    return most


def sphere_pose(
    frame: ArrayLike,
    camera: Camera,
    radius_mm: float | None = None,
    *,
    kind: Kind = "all-round",
    near: tuple[float, float, float] | None = None,
    radius_sd_mm: float = 0.0,
    depth_mm: float | None = None,
    cut: bool = False,
) -> SpherePose:
    """Centre of a sphere of known radius from its outline in one frame.

    Parameters
    ----------
    frame : (rows, columns) or (rows, columns, channels) array
        Linear radiance: the maximum over lights all round (`all_round`), a back-lit silhouette or a mask, or one
        picture under a single light.
    camera : Camera
        Intrinsics, distortion and pose.
    radius_mm : float, optional
        The sphere's radius, which sets its distance. An orthographic camera reads the radius off the picture and
        takes none, or one to check.
    kind : {"all-round", "silhouette", "single"}
        What the frame is; sets the systematic part of the uncertainty (`SYSTEMATIC_PX`).
    near : (u, v, radius), optional
        Roughly where the sphere is, px, where there are several round things in view.
    radius_sd_mm : float
        Standard uncertainty of the radius, mm.
    depth_mm : float, optional
        Depth of the centre before an orthographic camera, which cannot see it; ten radii where absent.
    cut : bool
        Take a sphere of which a part lies outside the picture; the rest of its outline places it.

    Raises
    ------
    InputError
        No sphere, two spheres, an outline that is not a sphere's under this camera (an ellipsoid, non-square pixels,
        wrong intrinsics), or a sphere cut by the frame.
    """
    image = grey(np.asarray(frame))
    if image.ndim != 2 or image.shape != (camera.height, camera.width):
        size = f"{image.shape[-1]}x{image.shape[0]}" if image.ndim == 2 else f"{image.ndim} axes"
        remedy = "calibrate the camera at the size of the pictures, or give the pictures uncropped"
        raise InputError.of("frame", size, f"must be the camera's {camera.width}x{camera.height} px", remedy)
    if not camera.orthographic and not (radius_mm is not None and radius_mm > 0):
        raise InputError.of("radius_mm", radius_mm, "must be > 0", "measure the sphere: its size sets its distance")
    found = candidates(image, camera, near)
    if not found:
        for start in [near] if near is not None else seeds(image):
            refuse_flattened(image, camera, fit_cone(circle_path(*start, 240)[0], camera))
        raise InputError.of(
            "frame",
            f"{camera.width}x{camera.height} px",
            "shows no sphere: no round outline stands out against its surroundings",
            "use a frame lit all round or from behind, see that the whole sphere is in view, or give near=(u, v, r)",
        )
    best = found[0]
    if near is None:
        refuse_second(found)
    if kind != "single" or best.support > 0.75:  # the terminator under one light is an ellipse
        refuse_flattened(image, camera, best.cone)
    if not cut:
        refuse_cut(camera, best)
    if best.cone.residual_px > max(0.4, 0.008 * best.circle[2]):
        raise InputError.of(
            "frame",
            f"edge points {best.cone.residual_px:.2f} px off the best circle",
            "shows no sphere with a clean outline",
            "use a frame lit all round or from behind, before a plain ground",
        )
    return _pose(
        camera,
        best,
        radius_mm,
        kind,
        radius_sd_mm,
        depth_mm,
        shaded_limb(image, camera, best.cone),
        edge_noise(image, best),
    )


def _pose(
    camera: Camera,
    best: Candidate,
    radius_mm: float | None,
    kind: Kind,
    radius_sd_mm: float,
    depth_mm: float | None,
    shaded: float,
    noise_px: float,
) -> SpherePose:
    cone = best.cone
    if kind not in SYSTEMATIC_PX:
        raise InputError.of("kind", kind, f"must be one of {', '.join(SYSTEMATIC_PX)}", "say what the frame is")
    rad_per_px = cone.half_angle / best.circle[2]
    centre_sys, radius_sys = SYSTEMATIC_PX["single" if shaded > 0.15 else kind]
    systematic = np.diag([centre_sys**2, centre_sys**2, radius_sys**2]) * rad_per_px**2
    three = cone.covariance + systematic
    x0 = np.append(np.zeros(3), radius_mm or 0.0)
    full = np.zeros((4, 4))
    full[:3, :3] = three
    full[3, 3] = radius_sd_mm**2

    def place(x: FloatArray) -> FloatArray:
        e1, e2 = tangents(cone.axis)
        axis = cone.axis + x[0] * e1 + x[1] * e2
        return _place(camera, axis / np.linalg.norm(axis), cone.half_angle + x[2], x[3], depth_mm)

    at = place(x0)
    steps = np.array([1e-6, 1e-6, 1e-6, 1e-6 * max(at[3], 1e-9)])
    jacobian = np.column_stack([(place(x0 + h) - place(x0 - h)) / (2 * h.sum()) for h in np.diag(steps)])
    covariance = jacobian @ full @ jacobian.T
    if camera.orthographic and radius_mm is not None and abs(at[3] / radius_mm - 1) > 0.02:
        raise InputError.of(
            "radius_mm",
            radius_mm,
            f"the picture shows {at[3]:.4g} mm under this orthographic camera",
            "mend the scale of the camera (mm per pixel) or the radius",
        )
    sd = np.sqrt(np.diag(three)) / rad_per_px
    return SpherePose(
        sphere=Sphere(centre_mm=at[:3], radius_mm=float(at[3])),
        covariance=covariance,
        circle_px=best.circle,
        circle_sd_px=(float(sd[0]), float(sd[1]), float(sd[2])),
        systematic_px=(centre_sys, radius_sys),
        residual_px=cone.residual_px,
        support=best.support,
        points=best.points[cone.used],
        outline=cone_outline(camera, cone.axis, cone.half_angle, 360)[0],
        kind=kind,
        notes=(*_notes(kind, shaded, best.support, (centre_sys, radius_sys)), *_elliptic(best)),
        ellipse_px=cone.ellipse_px,
        chance=cone.chance,
        noise_px=noise_px,
    )


def _notes(kind: Kind, shaded: float, support: float, systematic_px: tuple[float, float]) -> tuple[str, ...]:
    """What the outline leaves in doubt."""
    notes = []
    centre, radius = systematic_px
    if kind != "single" and shaded > 0.15:
        notes.append(
            f"The limb is dark along {shaded:.0%} of the outline, as the lights stand beside the camera: centre and "
            f"radius may be off by {centre} and {radius} px; add lights from the sides, or a silhouette."
        )
    if kind == "single":
        notes.append(
            f"A single light shades the limb: centre and radius may be off by {centre} and {radius} px; "
            "a frame lit all round or from behind is better."
        )
    if support < 0.6:
        notes.append(f"Only {support:.0%} of the outline could be used.")
    return tuple(notes)


_ROUND_PX, _ROUND = 0.25, 0.004
"""Ellipticity below which nothing is told: px, and as a share of the radius."""


def _elliptic(best: Candidate) -> list[str]:
    cone = best.cone
    if cone.chance > 1e-3 or cone.ellipse_px < max(_ROUND_PX, _ROUND * best.circle[2]):
        return []
    return [
        f"The outline is elliptic by {cone.ellipse_px:.2f} px, beyond its scatter: a focal length or lens that is "
        "wrong for these pictures, a ball that is not round, or a limb that is shaded to one side."
    ]


def _place(camera: Camera, axis: FloatArray, half_angle: float, radius_mm: float, depth_mm: float | None) -> FloatArray:
    """Centre (world, mm) and radius of the sphere that a cone grazes."""
    if camera.orthographic:
        u, v, r = circle_of(camera, axis, half_angle)
        radius = r / float(camera.matrix[0, 0])
        plane = (np.array([u, v]) - camera.matrix[:2, 2]) / np.diag(camera.matrix)[:2]
        at = np.append(plane, 10 * radius if depth_mm is None else depth_mm)
    else:
        radius = radius_mm
        at = axis * radius / np.sin(half_angle)
    return np.append(camera.rotation.T @ (at - camera.translation), radius)
