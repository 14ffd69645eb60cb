"""A virtual sphere rig: a camera, lights on an arc or a ring, a sphere, and the pictures they make.

Marschner et al. 2000 (Appl. Opt. 39:2592) measured a BRDF from photographs of a sphere under single lights: every pixel
sees another pair of angles. Here the photographs are rendered, so that the truth is known. The world's origin is the
sphere's centre and +z points to the camera; a light's angle is counted from there.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import xarray as xr

from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.errors import InputError
from livlab.units import FloatArray

Silhouette = Literal["all-round", "back-lit", "none"]

MARGIN_PX = 8
"""Dark pixels between the outline and the frame."""

MOST_PIXELS = 1 << 24
"""Pixels of a picture beyond which a rig is a mistake."""


@dataclass(frozen=True, eq=False)
class SphereRig:
    """Camera, lights and sphere, and how finely their pictures are sampled.

    Attributes
    ----------
    camera, lights, sphere
        In one world frame, mm.
    samples_per_pixel
        Rays a pixel and light; 16 stratified ones do what 4096 independent ones do.
    sampler
        Mitsuba's sampler.
    silhouette
        Outline frame beside the pictures: the sphere lit evenly from all round, black before a bright field, or none.
    """

    camera: Camera
    lights: tuple[Light, ...]
    sphere: Sphere
    samples_per_pixel: int = 16
    sampler: str = "multijitter"
    silhouette: Silhouette = "back-lit"

    def __post_init__(self) -> None:
        if not self.lights:
            raise InputError.of("rig.lights", (), "at least one light is needed", "Add a light.")
        if self.camera.width * self.camera.height > MOST_PIXELS:
            size = (self.camera.width, self.camera.height)
            raise InputError.of("rig.camera", size, f"more than {MOST_PIXELS} pixels", "Take fewer pixels.")
        if np.any(np.asarray(self.camera.distortion) != 0):
            raise InputError.of(
                "rig.camera.distortion", self.camera.distortion, "is not rendered", "Undistort, or leave it out."
            )

    @classmethod
    def make(
        cls,
        lights: Sequence[Light] | None = None,
        *,
        radius_px: float = 115.0,
        radius_mm: float = 25.0,
        camera_radii: float = 10.0,
        orthographic: bool = False,
        samples_per_pixel: int = 16,
        silhouette: Silhouette = "back-lit",
    ) -> SphereRig:
        """A camera that looks straight at a sphere whose outline has a radius of `radius_px`.

        Parameters
        ----------
        lights
            Default: the thesis's number, 8, on an arc from 10° to 130° at 10 radii.
        camera_radii
            Distance of the eye from the centre in radii, > 1.

        Examples
        --------
        >>> rig = SphereRig.make(radius_px=20)
        >>> len(rig.lights), rig.camera.width
        (8, 57)
        """
        for name, value, low in (
            ("radius_px", radius_px, 2.0),
            ("radius_mm", radius_mm, 0.0),
            ("camera_radii", camera_radii, 1.0),
        ):
            if not (math.isfinite(value) and value > low):
                raise InputError.of(f"rig.{name}", value, f"must be finite and > {low:g}", "Mend the number.")
        size = 2 * math.ceil(radius_px + MARGIN_PX) + 1
        distance = camera_radii * radius_mm
        focal = radius_px / radius_mm if orthographic else radius_px * math.sqrt(camera_radii**2 - 1.0)
        middle = (size - 1) / 2
        camera = Camera(
            size,
            size,
            np.array([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]]),
            np.diag([1.0, -1.0, -1.0]),
            np.array([0.0, 0.0, distance]),
            orthographic=orthographic,
        )
        made = tuple(arc(8, radius_mm=radius_mm) if lights is None else lights)
        return cls(camera, made, Sphere(np.zeros(3), radius_mm), samples_per_pixel, silhouette=silhouette)


@dataclass(frozen=True, eq=False)
class Photographs:
    """What a rig delivers, and what `livlab.brdf.sphere.extract` takes.

    Attributes
    ----------
    images
        (light, row, column, channel) linear radiance.
    camera, lights, sphere
        As they were when the pictures were taken.
    outline
        (row, column) silhouette frame or None.
    seconds
        What the rendering took.
    variance
        Variance of the images' values where the renderer knows it.
    """

    images: xr.DataArray
    camera: Camera
    lights: tuple[Light, ...]
    sphere: Sphere
    outline: xr.DataArray | None
    seconds: float
    variance: xr.DataArray | None = None


def direction(angle_deg: float, azimuth_deg: float = 0.0) -> FloatArray:
    """Unit vector at an angle from the direction to the camera; azimuth 0 is to the camera's right, 90° above."""
    a, b = math.radians(angle_deg), math.radians(azimuth_deg)
    return np.array([math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a)])


def light(
    angle_deg: float,
    azimuth_deg: float = 0.0,
    *,
    distance_radii: float = 10.0,
    radius_mm: float = 25.0,
    channels: int = 3,
) -> Light:
    """A light that gives unit irradiance at the sphere's centre: near, or distant where the distance is infinite.

    Raises
    ------
    InputError
        A distance within the sphere.
    """
    toward = direction(angle_deg, azimuth_deg)
    if math.isinf(distance_radii):
        return Light(np.ones(channels), direction=toward)
    if not distance_radii > 1.0:
        raise InputError.of("light.distance_radii", distance_radii, "must be > 1", "Move the light out of the sphere.")
    distance = distance_radii * radius_mm
    return Light(np.full(channels, distance**2), position_mm=distance * toward)


def arc(
    count: int,
    *,
    first_deg: float = 10.0,
    last_deg: float = 130.0,
    azimuth_deg: float = 0.0,
    distance_radii: float = 10.0,
    radius_mm: float = 25.0,
    channels: int = 3,
) -> tuple[Light, ...]:
    """Lights on an arc about the sphere, evenly from the first angle to the last."""
    _count(count)
    return tuple(
        light(float(a), azimuth_deg, distance_radii=distance_radii, radius_mm=radius_mm, channels=channels)
        for a in np.linspace(first_deg, last_deg, count)
    )


def ring(
    count: int,
    *,
    angle_deg: float = 45.0,
    distance_radii: float = 10.0,
    radius_mm: float = 25.0,
    channels: int = 3,
) -> tuple[Light, ...]:
    """Lights evenly round the camera's axis, all at one angle from it; 0° puts them where the camera is."""
    _count(count)
    return tuple(
        light(angle_deg, 360.0 * k / count, distance_radii=distance_radii, radius_mm=radius_mm, channels=channels)
        for k in range(count)
    )


def photograph(
    rig: SphereRig,
    material: Mapping[str, Any],
    *,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Photographs:
    """Pictures of a sphere of a material, one a light.

    Parameters
    ----------
    material
        Any opaque Mitsuba BSDF as a table (see `livlab.model.tracer.materials.material_dict`).
    seed
        Of the renderer.
    progress
        Called with the number of pictures done; it may raise to stop.

    Raises
    ------
    InputError
        The material lets light through, is a perfect mirror or unknown; a light lies within the sphere.
    EnvironmentProblem
        Mitsuba cannot run here.
    """
    from livlab.model.tracer.rig import photograph_sphere

    started = time.perf_counter()
    view = view_of(rig.camera)
    pictures = photograph_sphere(
        view,
        [_lamp(x) for x in rig.lights],
        rig.sphere.centre_mm,
        rig.sphere.radius_mm,
        material,
        samples=rig.samples_per_pixel,
        seed=seed,
        sampler=rig.sampler,
        progress=progress,
    )
    images = xr.DataArray(
        pictures,
        dims=("light", "row", "column", "channel"),
        coords={"channel": ["R", "G", "B"]},
        name="radiance",
        attrs={"units": "W m-2 sr-1", "long_name": "linear radiance"},
    )
    frame = outline(rig, seed=seed)
    return Photographs(images, rig.camera, rig.lights, rig.sphere, frame, time.perf_counter() - started)


def check_material(material: Mapping[str, Any]) -> None:
    """See that a sphere of a material can be measured.

    Raises
    ------
    InputError
        Mitsuba does not know it, it lets light through, or it is a perfect mirror.
    EnvironmentProblem
        Mitsuba cannot run here.
    """
    from livlab.model.tracer.materials import load_material

    load_material(material)


def true_value(material: Mapping[str, Any], wi: FloatArray, wo: FloatArray) -> FloatArray:
    """(n, channel) the BRDF that pictures of a material should show, 1/sr; see `tracer.materials.evaluate`."""
    from livlab.model.tracer.materials import evaluate

    return evaluate(material, wi, wo)


def outline(rig: SphereRig, *, samples: int = 256, seed: int = 0) -> xr.DataArray | None:
    """(row, column) the rig's silhouette frame, 0 to 1, with an edge at one half; None if it takes none."""
    from livlab.model.tracer.rig import silhouette

    if rig.silhouette == "none":
        return None
    back_lit = rig.silhouette == "back-lit"
    frame = silhouette(
        view_of(rig.camera),
        rig.sphere.centre_mm,
        rig.sphere.radius_mm,
        back_lit=back_lit,
        samples=samples,
        seed=seed,
    )
    return xr.DataArray(frame, dims=("row", "column"), attrs={"units": "1", "long_name": f"{rig.silhouette} frame"})


def moved(rig: SphereRig, centre_mm: FloatArray) -> SphereRig:
    """The same rig with the sphere elsewhere, lights and camera as they were."""
    return replace(rig, sphere=Sphere(np.asarray(centre_mm, dtype=float), rig.sphere.radius_mm))


def view_of(camera: Camera) -> Any:
    """A camera in the renderer's terms.

    Raises
    ------
    InputError
        Its pixels are not square.
    """
    from livlab.model.tracer.rig import RigView

    m = np.asarray(camera.matrix, dtype=float)
    if not math.isclose(m[0, 0], m[1, 1], rel_tol=1e-6) or m[0, 1] != 0:
        raise InputError.of(
            "rig.camera.matrix", m.tolist(), "the rendered camera has square pixels", "Set f_x = f_y and no skew."
        )
    return RigView(
        camera.width,
        camera.height,
        float(m[0, 0]),
        (float(m[0, 2]), float(m[1, 2])),
        np.asarray(camera.rotation, dtype=float),
        np.asarray(camera.translation, dtype=float),
        camera.orthographic,
    )


def _lamp(light: Light) -> Any:
    from livlab.model.tracer.rig import Lamp

    return Lamp(np.asarray(light.intensity, dtype=float), light.position_mm, light.direction)


def _count(count: int) -> None:
    if count < 1:
        raise InputError.of("lights.count", count, "must be ≥ 1", "Ask for at least one light.")
