"""The rig inside a data set of samples, so that samples alone say how their pixels looked at the sphere."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.errors import InputError

Rig = tuple[Camera, list[Light], Sphere]


def rig_variables(camera: Camera, lights: Sequence[Light], sphere: Sphere) -> dict[str, xr.DataArray]:
    """The rig as variables (`camera_*`, `light_*`, `sphere_*`) of a data set of samples, world frame, mm."""
    channels = len(lights[0].intensity)
    missing = np.full(3, np.nan)
    world = {"units": "mm", "frame": "world"}
    return {
        "camera_size": xr.DataArray([camera.width, camera.height], dims="width_height", attrs={"units": "pixel"}),
        "camera_matrix": xr.DataArray(camera.matrix, dims=("row3", "column3"), attrs={"units": "pixel"}),
        "camera_rotation": xr.DataArray(
            camera.rotation, dims=("row3", "column3"), attrs={"units": "1", "long_name": "world to camera"}
        ),
        "camera_translation": xr.DataArray(camera.translation, dims="xyz", attrs=world),
        "camera_distortion": xr.DataArray(
            camera.distortion, dims="coefficient", attrs={"units": "1", "long_name": "OpenCV's coefficients"}
        ),
        "camera_orthographic": xr.DataArray(np.int8(camera.orthographic)),
        "light_position": xr.DataArray(
            [missing if light.position_mm is None else light.position_mm for light in lights],
            dims=("light_index", "xyz"),
            attrs={**world, "comment": "NaN for a distant light"},
        ),
        "light_direction": xr.DataArray(
            [missing if light.direction is None else light.direction for light in lights],
            dims=("light_index", "xyz"),
            attrs={"units": "1", "frame": "world", "comment": "NaN for a near light"},
        ),
        "light_intensity": xr.DataArray(
            [np.broadcast_to(light.intensity, channels) for light in lights],
            dims=("light_index", "channel"),
            attrs={"comment": "distant: irradiance facing it; near: that times the squared distance in mm2"},
        ),
        "light_solid_angle": xr.DataArray(
            [light.solid_angle_sr for light in lights], dims="light_index", attrs={"units": "sr"}
        ),
        "sphere_centre": xr.DataArray(sphere.centre_mm, dims="xyz", attrs=world),
        "sphere_radius": xr.DataArray(float(sphere.radius_mm), attrs={"units": "mm"}),
    }


def _present(vector: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    return None if np.isnan(vector).any() else vector


def rig_of(samples: xr.Dataset) -> Rig:
    """Camera, lights and sphere of extracted samples.

    Raises
    ------
    InputError
        The samples carry no rig: they were not extracted from images of a sphere.
    """
    if "camera_matrix" not in samples:
        raise InputError.of(
            "samples",
            sorted(map(str, samples.data_vars)),
            "hold no camera, lights and sphere",
            "Use samples that livlab.brdf.sphere.extract made; others have no pixels.",
        )
    width, height = samples["camera_size"].values
    camera = Camera(
        int(width),
        int(height),
        samples["camera_matrix"].values,
        samples["camera_rotation"].values,
        samples["camera_translation"].values,
        samples["camera_distortion"].values,
        bool(samples["camera_orthographic"].values),
    )
    lights = [
        Light(intensity, _present(direction), _present(position), float(solid_angle))
        for intensity, direction, position, solid_angle in zip(
            samples["light_intensity"].values,
            samples["light_direction"].values,
            samples["light_position"].values,
            samples["light_solid_angle"].values,
            strict=True,
        )
    ]
    return camera, lights, Sphere(samples["sphere_centre"].values, float(samples["sphere_radius"].values))
