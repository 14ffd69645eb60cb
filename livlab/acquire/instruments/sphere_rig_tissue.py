"""A sphere of tissue in the virtual rig: pictures, by the tracer, of a body that light enters and leaves elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import xarray as xr

from livlab.acquire.instruments.sphere_rig import Photographs, SphereRig, outline, view_of
from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack


def photograph_tissue(
    rig: SphereRig,
    stack: OpticalStack,
    *,
    half_angle_deg: float = 5.0,
    seed: int = 0,
    variant: Literal["llvm", "cuda"] = "llvm",
    progress: Callable[[float], None] | None = None,
) -> Photographs:
    """Pictures of a sphere of tissue by the tracer, a channel a wavelength, with their variance.

    The same paths serve all pictures: see `livlab.model.tracer.rig_tissue`. `rig.samples_per_pixel` counts them. What
    the smooth surface mirrors is left out, as from the pictures of a rig with crossed polarisers.

    Parameters
    ----------
    rig
        Its camera looks straight at the sphere, its lights are distant.
    stack
        The tissue's layers and wavelengths; the last layer fills the sphere.
    half_angle_deg
        Of each light, a disc of the sky: the BRDF is averaged over it.
    seed
        Of the tracer.
    variant
        Where it runs: processor or graphics card.
    progress
        Called with the fraction done; it may raise to stop.

    Raises
    ------
    InputError
        A near light, a camera that looks past the centre, or layers above the last as thick as the sphere.
    EnvironmentProblem
        Mitsuba or the variant cannot run here.
    """
    from livlab.model.tracer.rig_tissue import exits, pictures

    started = time.perf_counter()
    eye, outline_px, centre = _on_axis(rig)
    disc = math.radians(half_angle_deg)
    if not 0 < disc < math.pi / 6:
        raise InputError.of("half_angle_deg", half_angle_deg, "must lie within (0, 30)", "Give 5, say.")
    angles = []
    for k, x in enumerate(rig.lights):
        if x.direction is None:
            raise InputError.of(
                f"rig.lights[{k}]", "near", "a tissue's lights are distant", 'Write distance_radii = "infinite".'
            )
        d = rig.camera.rotation @ np.asarray(x.direction, dtype=float)
        angles.append((math.acos(max(-1.0, min(1.0, -d[2]))), math.atan2(-d[1], d[0])))
    paths = max(1, round(math.pi * outline_px**2 * rig.samples_per_pixel))
    found = exits(stack, rig.sphere.radius_mm, eye, paths, seed=seed, variant=variant, progress=progress)
    size = (rig.camera.height, rig.camera.width)
    values, errors = pictures(found, angles, disc, outline_px, centre, size, seed=seed)
    strength = np.array([float(np.mean(x.intensity)) for x in rig.lights])[:, None, None, None]
    dims, coords = ("light", "row", "column", "channel"), {"channel": stack.wavelength_nm}
    about = {
        "units": "W m-2 sr-1",
        "long_name": "linear radiance; channels are wavelengths in nm",
        "paths": len(found.radius),
        "troubles": found.troubles,
        "given_up": float(found.given_up.max()),
    }
    images = xr.DataArray(values * strength, dims=dims, coords=coords, name="radiance", attrs=about)
    variance = xr.DataArray((errors * strength) ** 2, dims=dims, coords=coords)
    lights = tuple(replace(x, solid_angle_sr=2 * math.pi * (1 - math.cos(disc))) for x in rig.lights)
    return Photographs(
        images, rig.camera, lights, rig.sphere, outline(rig, seed=seed), time.perf_counter() - started, variance
    )


def _on_axis(rig: SphereRig) -> tuple[float, float, tuple[float, float]]:
    """Distance of the eye (infinite for parallel rays), radius of the outline in px and where its middle is."""
    camera, sphere = rig.camera, rig.sphere
    view = view_of(camera)
    at = camera.rotation @ sphere.centre_mm + camera.translation
    if math.hypot(at[0], at[1]) > 1e-6 * sphere.radius_mm:
        raise InputError.of(
            "rig.camera", at.tolist(), "looks past the sphere's centre", "Aim it: a tissue's rig is one about its axis."
        )
    if camera.orthographic:
        return math.inf, view.focal_px * sphere.radius_mm, view.centre_px
    distance = float(at[2])
    return distance, view.focal_px * sphere.radius_mm / math.sqrt(distance**2 - sphere.radius_mm**2), view.centre_px
