"""From what a picture experiment says of its scene to shapes, lights and objects that the tracer takes."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from livlab.effects.reduce import merged
from livlab.errors import InputError
from livlab.kinds.picture.config import PictureExperiment
from livlab.kinds.picture.config_scene import (
    AreaLight,
    BlockShape,
    DirectionalLight,
    Glass,
    LightSpec,
    LiverShape,
    ObjectSpec,
    PointLight,
    SphereShape,
    SpotLight,
    resolved_files,
)
from livlab.kinds.picture.light import area_radiance, directional_irradiance, point_intensity
from livlab.model.shapes import TriangleMesh, box, liver, sphere
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tracer import stage

GAP_MM = 0.01
"""What a cut leaves of the outer layer, so that two faces do not lie in one place."""

OUTER, INNER = "body", "inner"


@dataclass(frozen=True, eq=False)
class BodySurfaces:
    """What bounds a body: its surfaces from the outside in, and how thick the layer between them came out.

    Attributes
    ----------
    meshes
        By name, outer first.
    notes
        What a report must say.
    """

    meshes: dict[str, TriangleMesh]
    notes: tuple[str, ...] = ()


def body_mesh(config: PictureExperiment) -> TriangleMesh:
    """The body's surface, turned but not cut.

    Raises
    ------
    InputError, ConfigError
        A mesh file that cannot be read, has changed, or is no closed surface.
    """
    shape = config.geometry.shape
    if isinstance(shape, LiverShape):
        made = liver(shape.size_mm, shape.resolution_mm)
    elif isinstance(shape, SphereShape):
        made = sphere(shape.radius_mm)
    elif isinstance(shape, BlockShape):
        made = box(shape.size_mm)
    else:
        from livlab.model.shapes import check, read_mesh

        path = resolved_files(shape).path
        made = read_mesh(Path(path))
        check(made)
    if any(config.geometry.rotate_deg):
        matrix = np.eye(4)
        matrix[:3, :3] = stage.turned(np.radians(config.geometry.rotate_deg))
        made = made.transformed(matrix)
    return made


def nested_stack(stack: OpticalStack) -> OpticalStack:
    """The stack with its layers above the last as one, and all as one where the last is thin (a capsule alone).

    Two meshes tell two layers, as in the thesis; sublayers of some µm have no meshes of their own.
    """
    thin = [x.name for x in stack.layers if x.thickness_mm < stack.layers[-1].thickness_mm / 10.0]
    if math.isinf(stack.layers[-1].thickness_mm):
        thin = [x.name for x in stack.layers[:-1]]
    merging = thin or [x.name for x in stack.layers]
    # Sublayers are "capsule 1", "capsule 2", …: together they are the capsule.
    stems = dict.fromkeys(re.sub(r" \d+$", "", name) for name in merging)
    return merged(stack, frozenset(merging), " and ".join(stems))


def surfaces(config: PictureExperiment, whole: TriangleMesh, stack: OpticalStack) -> BodySurfaces:
    """The meshes that bound a body of these layers, cut if the experiment says so.

    Parameters
    ----------
    whole
        The uncut surface.
    stack
        Layers; for nested layering as `nested_stack` gives them.

    Raises
    ------
    InputError
        A shell that does not fit into the body, or a cut that misses it.
    """
    from livlab.model.shapes.section import Plane, section
    from livlab.model.shapes.shell import inset

    cut = config.geometry.cut
    inner, notes = None, []
    layers = stack.layers
    shell = layers[0].thickness_mm
    if config.geometry.layering == "nested" and (len(layers) > 1 or shell < float(whole.extent.min()) / 2.0):
        found = inset(whole, shell, "distance")
        inner = found.mesh
        t = found.depth
        notes.append(
            f"The inner mesh lies {t.median_mm:.4g} mm deep in the median ({t.minimum_mm:.4g}–{t.maximum_mm:.4g} mm), "
            f"{shell:.4g} mm being asked for."
        )
        notes += found.warnings
    outer = whole
    if cut is not None:
        made = section(whole, inner, planes=Plane(cut.point_mm, cut.normal), gap_mm=GAP_MM)
        outer, inner = made.outer, made.inner
        if inner is not None:
            notes.append(f"The cut leaves {1e3 * GAP_MM:g} µm of the outer layer, so that no two faces coincide.")
    return BodySurfaces({OUTER: outer} if inner is None else {OUTER: outer, INNER: inner}, tuple(notes))


def furnish(mi: Any, config: PictureExperiment) -> dict[str, Any]:
    """Camera, lights and other objects of a scene, without the body."""
    c = config.camera
    made: dict[str, Any] = {
        "sensor": stage.sensor(mi, c.position_mm, c.target_mm, c.up, math.radians(c.fov_deg), c.width, c.height)
    }
    for k, light in enumerate(config.light):
        made[f"light_{k}"] = _light(mi, light, c.target_mm)
    for k, thing in enumerate(config.object):
        made[f"object_{k}"] = _object(mi, thing)
    return made


def _light(mi: Any, light: LightSpec, target: tuple[float, float, float]) -> dict[str, Any]:
    if isinstance(light, AreaLight):
        radiance = area_radiance(light.level, light.position_mm, light.size_mm, target)
        return stage.rectangle_light(mi, light.position_mm, target, light.size_mm, radiance)
    if isinstance(light, PointLight):
        return stage.point_light(light.position_mm, point_intensity(light.level, light.position_mm, target))
    if isinstance(light, SpotLight):
        strength = point_intensity(light.level, light.position_mm, target)
        cone, even = math.radians(light.cone_deg), math.radians(light.even_deg)
        return stage.spot_light(mi, light.position_mm, target, strength, cone, even)
    if isinstance(light, DirectionalLight):
        return stage.parallel_light(light.towards, directional_irradiance(light.level))
    image = None if light.image is None else light.image.resolve().path
    return stage.surrounding_light(mi, light.level, image)


def _object(mi: Any, thing: ObjectSpec) -> dict[str, Any]:
    material = thing.material
    if isinstance(material, Glass):
        bsdf = stage.glass(material.n)
    elif material.kind == "metal":
        bsdf = stage.metal(mi, material.reflectance, material.roughness)
    else:
        bsdf = stage.matt(mi, material.reflectance)
    return stage.thing(mi, thing.shape, thing.scale_mm, np.radians(thing.rotate_deg), thing.position_mm, bsdf)


def check_layering(config: PictureExperiment) -> None:
    """Refuse what a depth test cannot tell.

    Raises
    ------
    InputError
        A cut body whose layers are told by their depth: the cut would have a capsule too.
    """
    if config.geometry.cut is not None and config.geometry.layering == "depth":
        raise InputError.of(
            "geometry.layering",
            "depth",
            "cannot tell a cut from the surface, and would cover it with the outer layers",
            "Write layering = 'nested'.",
        )
