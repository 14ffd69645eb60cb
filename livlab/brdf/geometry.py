"""The rig in which a sphere is pictured: camera, lights, sphere, all in one right-handed world frame in mm.

Conventions. `wi` points from the surface to the light, `wo` to the eye, both unit vectors away from the surface; a
BRDF carries no cosine. Pixel (column u, row v) has its centre at (u, v), rows downwards, as OpenCV has it; a camera
looks along its own +z with x to the right and y downwards.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]


def _vector(name: str, value: npt.ArrayLike) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise InputError.of(name, value, "three finite numbers", "give x, y and z")
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
        OpenCV's coefficients; empty for none.
    orthographic : bool
        Parallel projection.
    """

    width: int
    height: int
    matrix: FloatArray
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    translation: FloatArray = field(default_factory=lambda: np.zeros(3))
    distortion: FloatArray = field(default_factory=lambda: np.zeros(0))
    orthographic: bool = False


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
        Solid angle that the source subtends from the sphere; 0 for a point.
    """

    intensity: FloatArray
    direction: FloatArray | None = None
    position_mm: FloatArray | None = None
    solid_angle_sr: float = 0.0

    def __post_init__(self) -> None:
        if (self.direction is None) == (self.position_mm is None):
            raise InputError.of("light", self, "a direction or a position, not both", "give exactly one of the two")


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere: centre (mm, world frame) and radius (mm)."""

    centre_mm: FloatArray
    radius_mm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre_mm", _vector("sphere.centre_mm", self.centre_mm))
        if not self.radius_mm > 0:
            raise InputError.of("sphere.radius_mm", self.radius_mm, "> 0", "give the radius in mm")
