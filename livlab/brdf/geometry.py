"""The rig in which a sphere is pictured: camera, lights, sphere, all in one right-handed world frame in mm.

Conventions. `wi` points from the surface to the light, `wo` to the eye, both unit vectors away from the surface; a
BRDF carries no cosine. Pixel (column u, row v) has its centre at (u, v), rows downwards, as OpenCV has it; a camera
looks along its own +z with x to the right and y downwards.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from livlab.brdf.lens import LENGTHS, distorted, undistorted
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


def _vector(name: str, value: npt.ArrayLike) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise InputError.of(name, value, "three finite numbers", "give x, y and z")
    return array


def _matrix(name: str, value: npt.ArrayLike) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3, 3) or not np.all(np.isfinite(array)):
        raise InputError.of(name, np.shape(value), "must be 3 by 3 finite numbers", "Give three rows of three.")
    return array


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with lens distortion, or an orthographic one.

    A world point X has camera coordinates x = R X + t; a perspective camera then projects with OpenCV's model,
    u = f_x x'/z' + c_x and v = f_y y'/z' + c_y after `distortion` (k1, k2, p1, p2, k3). An orthographic one projects
    u = x / mm_per_pixel + c_x, v = y / mm_per_pixel + c_y.

    Parameters
    ----------
    width, height : int
        Pixels.
    matrix : (3, 3) array
        Intrinsic matrix; of an orthographic camera f_x = f_y = 1 / mm_per_pixel.
    rotation : (3, 3) array
        World to camera.
    translation : (3,) array
        World to camera, mm.
    distortion : (n,) array
        OpenCV's coefficients, 4, 5, 8, 12 or 14 of them; empty for none.
    orthographic : bool
        Parallel projection.

    Raises
    ------
    InputError
        No pixels, a singular matrix or one that is not upper triangular with 1 below, a rotation that is not one.
    """

    width: int
    height: int
    matrix: FloatArray
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    translation: FloatArray = field(default_factory=lambda: np.zeros(3))
    distortion: FloatArray = field(default_factory=lambda: np.zeros(0))
    orthographic: bool = False

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            size = getattr(self, name)
            if not (float(size).is_integer() and size >= 1):
                raise InputError.of(f"camera.{name}", size, "must be a whole number >= 1", "Give the image's size.")
            object.__setattr__(self, name, int(size))
        matrix = _matrix("camera.matrix", self.matrix)
        upper = np.array_equal(matrix[2], [0.0, 0.0, 1.0]) and matrix[1, 0] == 0
        if not (upper and matrix[0, 0] > 0 and matrix[1, 1] > 0):
            raise InputError.of(
                "camera.matrix",
                matrix.tolist(),
                "must be [[f_x, s, c_x], [0, f_y, c_y], [0, 0, 1]] with f_x, f_y > 0, not singular or mirrored",
                "Give focal lengths and centre in pixels; a mirrored picture is to be flipped first.",
            )
        rotation = _matrix("camera.rotation", self.rotation)
        off = float(np.max(np.abs(rotation @ rotation.T - np.eye(3))))
        if off > 1e-6 or np.linalg.det(rotation) < 0:
            raise InputError.of(
                "camera.rotation",
                rotation.tolist(),
                f"must be a rotation (R R^T differs from 1 by {off:.2g}, determinant {np.linalg.det(rotation):.3g})",
                "Give the world-to-camera rotation; cv2.Rodrigues makes one from a rotation vector.",
            )
        lens = np.asarray(self.distortion, dtype=np.float64).reshape(-1)
        if lens.size not in LENGTHS or not np.all(np.isfinite(lens)):
            raise InputError.of(
                "camera.distortion",
                lens.tolist(),
                "must be 0, 4, 5, 8, 12 or 14 finite numbers",
                "Give k1, k2, p1, p2[, k3[, k4, k5, k6[, s1..s4[, tx, ty]]]].",
            )
        if self.orthographic and lens.any():
            raise InputError.of(
                "camera.distortion", lens.tolist(), "an orthographic camera has none", "Undistort the images first."
            )
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", _vector("camera.translation", self.translation))
        object.__setattr__(self, "distortion", lens)

    @property
    def centre_mm(self) -> FloatArray:
        """Centre of projection (3,) in the world, mm; of an orthographic camera the point it measures depth from."""
        return np.asarray(-self.rotation.T @ self.translation)

    @property
    def axis(self) -> FloatArray:
        """Direction (3,) in the world in which the camera looks."""
        return np.asarray(self.rotation[2])

    def project(self, points_mm: npt.ArrayLike) -> FloatArray:
        """Pixel coordinates (..., 2), column and row, of world points (..., 3); NaN behind a perspective camera."""
        x = np.asarray(points_mm, dtype=np.float64) @ self.rotation.T + self.translation
        if self.orthographic:
            plane = x[..., :2]
        else:
            with np.errstate(invalid="ignore", divide="ignore"):
                plane = np.where(x[..., 2:] > 0, x[..., :2] / x[..., 2:], np.nan)
            plane = distorted(plane, self.distortion)
        return np.asarray(plane @ self.matrix[:2, :2].T + self.matrix[:2, 2])

    def rays(self, columns: npt.ArrayLike, rows: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Origins and unit directions (..., 3) in the world of the rays through pixel coordinates, centres whole.

        Raises
        ------
        InputError
            The lens distortion cannot be inverted at one of the pixels.
        """
        pixels = np.stack(np.broadcast_arrays(np.asarray(columns, float), np.asarray(rows, float)), axis=-1)
        plane = (pixels - self.matrix[:2, 2]) @ np.linalg.inv(self.matrix[:2, :2]).T
        if self.orthographic:
            origins = (np.concatenate([plane, np.zeros_like(plane[..., :1])], -1) - self.translation) @ self.rotation
            return origins, np.broadcast_to(self.axis, origins.shape)
        plane = undistorted(plane, self.distortion)
        towards = np.concatenate([plane, np.ones_like(plane[..., :1])], -1) @ self.rotation
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        return np.broadcast_to(self.centre_mm, towards.shape), towards


@dataclass(frozen=True, eq=False)
class Light:
    """A light: distant (`direction`) or near (`position_mm`), exactly one of the two.

    Parameters
    ----------
    direction : (3,) array or None
        Unit vector from the sphere towards a distant light.
    position_mm : (3,) array or None
        Centre of a near light; irradiance falls with the squared distance.
    intensity : (channels,) array
        Distant: irradiance on a surface that faces it (W/m2 or any unit the images share). Near: radiant intensity in
        that unit times mm2, so that E = intensity / distance_mm**2.
    solid_angle_sr : float
        Solid angle that the source subtends from the sphere's centre; 0 for a point.

    Raises
    ------
    InputError
        Both or neither of direction and position, a direction that is not of unit length, an intensity <= 0.
    """

    intensity: FloatArray
    direction: FloatArray | None = None
    position_mm: FloatArray | None = None
    solid_angle_sr: float = 0.0

    def __post_init__(self) -> None:
        if (self.direction is None) == (self.position_mm is None):
            raise InputError.of("light", self, "a direction or a position, not both", "give exactly one of the two")
        intensity = np.atleast_1d(np.asarray(self.intensity, dtype=np.float64))
        if intensity.ndim != 1 or intensity.size == 0 or not np.all(np.isfinite(intensity) & (intensity > 0)):
            raise InputError.of(
                "light.intensity",
                self.intensity,
                "must be one number > 0 for each channel",
                "Give what a white target measures, or 1 where only relative values matter; drop a light that was off.",
            )
        object.__setattr__(self, "intensity", intensity)
        if self.direction is not None:
            direction = _vector("light.direction", self.direction)
            length = float(np.linalg.norm(direction))
            if abs(length - 1) > 1e-6:
                raise InputError.of(
                    "light.direction",
                    direction.tolist(),
                    f"must be a unit vector, its length is {length:.6g}",
                    "Divide it by its length; for a near light give position_mm.",
                )
            object.__setattr__(self, "direction", direction / length)
        if self.position_mm is not None:
            object.__setattr__(self, "position_mm", _vector("light.position_mm", self.position_mm))
        if not 0 <= self.solid_angle_sr < 2 * np.pi:
            raise InputError.of(
                "light.solid_angle_sr", self.solid_angle_sr, "must lie in [0, 2 pi)", "Give 0 for a point source."
            )

    @property
    def near(self) -> bool:
        """Whether the light has a position."""
        return self.position_mm is not None

    def at(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit directions (..., 3) from points to the light, and E / intensity (...): 1, or 1/distance_mm**2."""
        if self.position_mm is None:
            return np.broadcast_to(self.direction, points_mm.shape), np.ones(points_mm.shape[:-1])  # type: ignore[arg-type]
        towards = self.position_mm - points_mm
        squared = np.einsum("...i,...i->...", towards, towards)
        return towards / np.sqrt(squared)[..., None], 1 / squared


class Hits(NamedTuple):
    """Where rays meet a sphere: whether (...), the points (..., 3) in mm, the outward normals (..., 3).

    A ray that misses gets the point where it passes the centre, and its normal there points away from the centre.
    """

    hit: BoolArray
    points_mm: FloatArray
    normals: FloatArray


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere: centre (mm, world frame) and radius (mm)."""

    centre_mm: FloatArray
    radius_mm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre_mm", _vector("sphere.centre_mm", self.centre_mm))
        if not 0 < self.radius_mm < np.inf:
            raise InputError.of("sphere.radius_mm", self.radius_mm, "must be finite and > 0", "give the radius in mm")

    def meet(self, origins: FloatArray, directions: FloatArray) -> Hits:
        """First meeting of rays from outside with the sphere; the rays are lines, their origin does not bound them."""
        to_centre = self.centre_mm - origins
        along = np.einsum("...i,...i->...", to_centre, directions)
        # Offset of the line from the centre as a vector: its length has no cancellation, however far the camera.
        offset = along[..., None] * directions - to_centre
        half_chord2 = self.radius_mm**2 - np.einsum("...i,...i->...", offset, offset)
        hit = half_chord2 >= 0
        from_centre = offset - np.sqrt(np.where(hit, half_chord2, 0.0))[..., None] * directions
        lengths = np.linalg.norm(from_centre, axis=-1, keepdims=True)
        return Hits(hit, self.centre_mm + from_centre, from_centre / np.where(lengths > 0, lengths, 1.0))

    def outline(self, camera: Camera, count: int = 256) -> FloatArray:
        """Pixel coordinates (count, 2) of the sphere's outline; NaN where it lies behind the camera."""
        view = camera.axis if camera.orthographic else self.centre_mm - camera.centre_mm
        distance = float(np.linalg.norm(view))
        sine = 0.0 if camera.orthographic else min(self.radius_mm / distance, 1.0)
        view = view / distance
        first = np.cross(view, np.eye(3)[np.argmin(np.abs(view))])
        first /= np.linalg.norm(first)
        turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
        around = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * np.cross(view, first)
        normals = -sine * view + np.sqrt(1 - sine**2) * around
        return camera.project(self.centre_mm + self.radius_mm * normals)
