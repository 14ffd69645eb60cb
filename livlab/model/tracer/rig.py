"""Pictures of a sphere under single lights, rendered by Mitsuba: what a camera in a sphere rig sees.

Cameras follow OpenCV (x right, y down, z ahead; pixel (u, v) has its centre at (u, v)); Mitsuba's look along +z with
x to the left and y up and count from a pixel's corner: converted here and nowhere else. Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tracer.materials import RIG_VARIANT, load_material, material_dict
from livlab.model.tracer.variant import mitsuba
from livlab.units import FloatArray

SPP_A_PASS = 1024
"""Mitsuba's film sums in single precision; passes beyond this are averaged in double."""


@dataclass(frozen=True)
class RigView:
    """A pinhole or parallel camera with square pixels and no distortion.

    Attributes
    ----------
    width, height
        Pixels.
    focal_px
        Focal length in pixels; of a parallel camera pixels per mm.
    centre_px
        Principal point (u, v).
    rotation, translation_mm
        World to camera.
    parallel
        Orthographic.
    """

    width: int
    height: int
    focal_px: float
    centre_px: tuple[float, float]
    rotation: FloatArray
    translation_mm: FloatArray
    parallel: bool = False


@dataclass(frozen=True)
class Lamp:
    """One light: `position_mm` (near) or `direction` (distant, towards the light).

    Attributes
    ----------
    intensity
        (channels,) near: radiant intensity, E = intensity / distance²; distant: irradiance facing it.
    """

    intensity: FloatArray
    position_mm: FloatArray | None = None
    direction: FloatArray | None = None


def sensor(
    mi: Any, view: RigView, *, samples: int, sampler: str = "multijitter", channels: str = "rgb"
) -> dict[str, Any]:
    """A view as Mitsuba's sensor: box filter, float32 film."""
    if samples < 1 or samples != int(samples):
        raise InputError.of("samples_per_pixel", samples, "must be a whole number ≥ 1", "Ask for at least one.")
    eye = -view.rotation.T @ view.translation_mm
    to_world = np.eye(4)
    to_world[:3, :3] = view.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    to_world[:3, 3] = eye
    out: dict[str, Any] = {
        "film": {
            "type": "hdrfilm",
            "width": view.width,
            "height": view.height,
            "pixel_format": channels,
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": sampler, "sample_count": samples},
        "near_clip": 1e-3 * max(1.0, float(np.linalg.norm(eye))),
        "far_clip": 1e3 * max(1.0, float(np.linalg.norm(eye))),
    }
    # The film's middle lies at (size − 1)/2 where centres count from 0; an offset moves the film, not the picture.
    off = [((n - 1) / 2 - c) / n for c, n in zip(view.centre_px, (view.width, view.height), strict=True)]
    if view.parallel:
        half = view.width / (2.0 * view.focal_px)
        shift = np.eye(4)
        shift[0, 3], shift[1, 3] = (-2 * half * off[0], -2 * half * off[1] * view.height / view.width)
        out |= {"type": "orthographic", "to_world": _transform(mi, to_world @ shift @ np.diag([half, half, 1.0, 1.0]))}
        return out
    fov = 2.0 * math.degrees(math.atan(view.width / (2.0 * view.focal_px)))
    return out | {
        "type": "perspective",
        "fov": fov,
        "fov_axis": "x",
        "principal_point_offset_x": off[0],
        "principal_point_offset_y": off[1],
        "to_world": _transform(mi, to_world),
    }


def photograph_sphere(
    view: RigView,
    lamps: Sequence[Lamp],
    centre_mm: FloatArray,
    radius_mm: float,
    material: Mapping[str, Any],
    *,
    samples: int = 16,
    seed: int = 0,
    sampler: str = "multijitter",
    variant: str = RIG_VARIANT,
    progress: Callable[[int], None] | None = None,
) -> FloatArray:
    """One linear picture a light, of light reflected once by the sphere.

    Parameters
    ----------
    samples
        Per pixel and light; stratified over the pixel.
    seed
        Of the sampler; each light has its own.
    progress
        Called with the number of pictures done; it may raise to stop.

    Returns
    -------
    (lights, height, width, channels) array
        Radiance in the lights' unit per sr.

    Raises
    ------
    InputError
        The material cannot be measured on a sphere, or a light lies within the sphere.
    """
    mi = mitsuba(variant)
    load_material(material, variant)
    pictures = []
    for k, lamp in enumerate(lamps):
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
                "sensor": sensor(mi, view, samples=min(samples, SPP_A_PASS), sampler=sampler),
                "ball": _sphere(mi, centre_mm, radius_mm) | {"bsdf": material_dict(material)},
                "lamp": _emitter(mi, k, lamp, centre_mm, radius_mm),
            },
            optimize=False,
        )
        pictures.append(_developed(mi, scene, samples, seed * 4099 + k))
        if progress is not None:
            progress(k + 1)
    return np.stack(pictures)


def silhouette(
    view: RigView,
    centre_mm: FloatArray,
    radius_mm: float,
    *,
    back_lit: bool = True,
    samples: int = 256,
    seed: int = 0,
    variant: str = RIG_VARIANT,
) -> FloatArray:
    """(height, width) outline frame: a black sphere before a bright field (1), or evenly lit before black.

    The share of a pixel that the sphere covers is 1 less the value, or the value; an edge lies at one half.
    """
    mi = mitsuba(variant)
    shade = 0.0 if back_lit else 1.0
    scene = mi.load_dict(
        {
            "type": "scene",
            # An even sky on a white sphere is even: bsdf samples alone meet it without noise.
            "integrator": {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1, "hide_emitters": not back_lit},
            "sensor": sensor(mi, view, samples=samples),
            "ball": _sphere(mi, centre_mm, radius_mm)
            | {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [shade] * 3}}},
            "field": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}},
        },
        optimize=False,
    )
    return np.asarray(_developed(mi, scene, samples, seed).mean(-1))


def _developed(mi: Any, scene: Any, samples: int, seed: int) -> FloatArray:
    passes = math.ceil(samples / SPP_A_PASS)
    total = None
    for k in range(passes):
        image = np.array(mi.render(scene, seed=(seed * 8191 + k) % 2**32, spp=min(samples, SPP_A_PASS)), dtype=float)
        total = image if total is None else total + image
    assert total is not None
    return np.asarray(total / passes)


def _sphere(mi: Any, centre: FloatArray, radius: float) -> dict[str, Any]:
    return {"type": "sphere", "center": [float(x) for x in centre], "radius": float(radius)}


def _emitter(mi: Any, k: int, lamp: Lamp, centre: FloatArray, radius: float) -> dict[str, Any]:
    power = {"type": "rgb", "value": [float(x) for x in np.broadcast_to(lamp.intensity, 3)]}
    if lamp.position_mm is None:
        assert lamp.direction is not None
        return {"type": "directional", "direction": [-float(x) for x in lamp.direction], "irradiance": power}
    if np.linalg.norm(lamp.position_mm - centre) <= radius:
        raise InputError.of(f"lights[{k}].position_mm", lamp.position_mm, "lies within the sphere", "Move it out.")
    return {"type": "point", "position": [float(x) for x in lamp.position_mm], "intensity": power}


def _transform(mi: Any, matrix: FloatArray) -> Any:
    return mi.ScalarTransform4f(np.asarray(matrix, dtype=np.float64))
