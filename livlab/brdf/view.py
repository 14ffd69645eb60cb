"""What each pixel of a camera sees of a sphere: point, normal, direction to the eye, solid angle, area."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from livlab.brdf.geometry import Camera, Sphere
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class View:
    """The pixels whose centres see the sphere well enough.

    Attributes
    ----------
    row_range, column_range
        First and one past the last row and column of the box around the sphere.
    rows, columns : (n,) int arrays
        The pixels.
    points_mm, normals, to_eye : (n, 3) arrays
        What their centres see, in the world.
    cos_o : (n,) array
        Cosine between normal and eye.
    solid_angle_sr : (n,) array
        Of the pixel, from the camera; 0 of an orthographic one.
    area_mm2 : (n,) array
        Of the sphere's surface that the pixel sees, to first order.
    radius_px
        Radius of a disc as large as the sphere's outline, in pixels.
    """

    row_range: tuple[int, int]
    column_range: tuple[int, int]
    rows: IntArray
    columns: IntArray
    points_mm: FloatArray
    normals: FloatArray
    to_eye: FloatArray
    cos_o: FloatArray
    solid_angle_sr: FloatArray
    area_mm2: FloatArray
    radius_px: float


def check_outside(camera: Camera, sphere: Sphere) -> None:
    """See that the camera stands outside the sphere and in front of it.

    Raises
    ------
    InputError
        It does not.
    """
    if camera.orthographic:
        return
    offset = sphere.centre_mm - camera.centre_mm
    distance = float(np.linalg.norm(offset))
    if distance <= sphere.radius_mm * (1 + 1e-9):
        raise InputError.of(
            "camera",
            f"{distance:.6g} mm from the sphere's centre",
            f"must stand outside the sphere of radius {sphere.radius_mm:.6g} mm",
            "Check the camera's translation, the sphere's centre and their unit, mm.",
        )
    if float(offset @ camera.axis) <= sphere.radius_mm:
        raise InputError.of(
            "camera",
            f"sphere's depth {float(offset @ camera.axis):.6g} mm",
            "must have the whole sphere in front of it",
            "Check the rotation: it takes world to camera, and the camera looks along its own +z.",
        )


def see(camera: Camera, sphere: Sphere, *, max_angle: float, grazing_px: float, cut: bool, max_pixels: int) -> View:
    """The pixels that see the sphere at θ_o <= `max_angle` with (1 − sin θ_o) R_px >= `grazing_px`.

    Raises
    ------
    InputError
        The camera is inside or behind, the frame cuts the sphere (unless `cut`), the sphere is too small for the
        grazing rule or covers more than `max_pixels`.
    """
    check_outside(camera, sphere)
    outline = sphere.outline(camera)
    low, high = outline.min(axis=0), outline.max(axis=0)
    size = np.array([camera.width, camera.height])
    if not np.all(np.isfinite(outline)) or (not cut and bool(np.any(low < -0.5) or np.any(high > size - 0.5))):
        raise InputError.of(
            "sphere",
            f"columns {low[0]:.1f} to {high[0]:.1f}, rows {low[1]:.1f} to {high[1]:.1f}",
            f"is cut by the frame of {camera.width} x {camera.height} pixels",
            "Picture the whole sphere, or pass cut=True to use the part inside.",
        )
    shifted = np.roll(outline, -1, axis=0)
    area_px = 0.5 * abs(float(np.sum(outline[:, 0] * shifted[:, 1] - outline[:, 1] * shifted[:, 0])))
    radius_px = float(np.sqrt(area_px / np.pi))
    first = np.clip(np.floor(low), 0, size).astype(int)
    last = np.clip(np.ceil(high) + 1, 0, size).astype(int)
    wide, tall = last - first
    if wide * tall > max_pixels:
        raise InputError.of(
            "sphere",
            f"{wide} x {tall} pixels",
            f"covers more than the {max_pixels} pixels that max_bytes has room for",
            "Bin the images (livlab.brdf.images.binned), or raise max_bytes.",
        )
    columns, rows = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    origins, directions = camera.rays(columns, rows)
    hits = sphere.meet(origins, directions)
    cos_o = -np.einsum("...i,...i->...", hits.normals, directions)
    sine = np.sqrt(np.clip(1 - cos_o**2, 0, 1))
    keep = hits.hit & (cos_o >= np.cos(max_angle)) & ((1 - sine) * radius_px >= grazing_px)
    if not keep.any():
        raise InputError.of(
            "sphere",
            f"radius of {radius_px:.3g} pixels",
            "leaves no pixel after the limits on the angle and on grazing",
            "Use a picture in which the sphere is larger, or check centre and radius.",
        )
    solid = _solid_angles(camera, first, last)[keep]
    distance2 = np.sum((hits.points_mm[keep] - origins[keep]) ** 2, axis=-1)
    if camera.orthographic:
        area = 1 / (camera.matrix[0, 0] * camera.matrix[1, 1]) / cos_o[keep]
    else:
        area = solid * distance2 / cos_o[keep]
    return View(
        row_range=(int(first[1]), int(last[1])),
        column_range=(int(first[0]), int(last[0])),
        rows=rows[keep].astype(np.int32),
        columns=columns[keep].astype(np.int32),
        points_mm=hits.points_mm[keep],
        normals=hits.normals[keep],
        to_eye=-directions[keep],
        cos_o=cos_o[keep],
        solid_angle_sr=solid,
        area_mm2=area,
        radius_px=radius_px,
    )


def _solid_angles(camera: Camera, first: npt.NDArray[np.int_], last: npt.NDArray[np.int_]) -> FloatArray:
    """Solid angle (rows, columns) of each pixel of a box, from the rays through its corners."""
    if camera.orthographic:
        return np.zeros((last[1] - first[1], last[0] - first[0]))
    columns, rows = np.meshgrid(np.arange(first[0], last[0] + 1) - 0.5, np.arange(first[1], last[1] + 1) - 0.5)
    _, corner = camera.rays(columns, rows)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    return _triangle(a, b, c) + _triangle(a, c, d)


def _triangle(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Solid angle of small spherical triangles (Van Oosterom & Strackee 1983, eq. 8), by differences of the corners."""
    volume = np.abs(np.einsum("...i,...i->...", a, np.cross(b - a, c - a)))
    dot = [np.einsum("...i,...i->...", p, q) for p, q in ((a, b), (b, c), (c, a))]
    return np.asarray(2 * np.arctan2(volume, 1 + dot[0] + dot[1] + dot[2]))
