"""A picture's scene for Mitsuba: camera, lights, bodies and other objects, in mm and at any wavelength.

Spectra are even (a source) or three numbers at the thesis's primaries, linear between them (a surface). Every function
gives what `mitsuba.load_dict` takes; no class of Mitsuba's leaves this package but inside such a dictionary.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from livlab.errors import InputError
from livlab.model.shapes import TriangleMesh
from livlab.units import FloatArray

VARIANT = "llvm_ad_spectral"
PRIMARIES_NM = (435.8, 546.1, 700.0)
VISIBLE_NM = (360.0, 830.0)
"""Where Mitsuba's spectral variants have spectra."""

SHAPES = {"sphere": "sphere", "rectangle": "rectangle", "block": "cube", "cylinder": "cylinder"}


def sensor(
    mi: Any, position: ArrayLike, target: ArrayLike, up: ArrayLike, fov_rad: float, width: int, height: int
) -> dict[str, Any]:
    """A pinhole camera whose angle of view is over the width; box filter, so that a pixel's error is its own."""
    distance = float(np.linalg.norm(np.subtract(target, position)))
    return {
        "type": "perspective",
        "fov": math.degrees(fov_rad),
        "fov_axis": "x",
        "near_clip": 1e-3 * distance,
        "far_clip": 1e3 * distance,
        "to_world": _look_at(mi, position, target, up),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "luminance",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }


def even(value: float) -> dict[str, Any]:
    """The same at every wavelength."""
    return {"type": "uniform", "value": float(value)}


def rectangle_light(
    mi: Any, position: ArrayLike, target: ArrayLike, size: ArrayLike, radiance: float
) -> dict[str, Any]:
    """A rectangle that faces the target and shines on that side."""
    half = np.asarray(size, dtype=np.float64) / 2.0
    axis = np.subtract(target, position)
    return {
        "type": "rectangle",
        "to_world": _look_at(mi, position, target, across(axis))
        @ mi.ScalarTransform4f().scale([half[0], half[1], 1.0]),
        "bsdf": {"type": "diffuse", "reflectance": even(0.0)},
        "emitter": {"type": "area", "radiance": even(radiance)},
    }


def point_light(position: ArrayLike, intensity: float) -> dict[str, Any]:
    """A point that shines alike in all directions."""
    return {"type": "point", "position": np.asarray(position, dtype=float).tolist(), "intensity": even(intensity)}


def spot_light(
    mi: Any, position: ArrayLike, target: ArrayLike, intensity: float, cone_rad: float, even_rad: float
) -> dict[str, Any]:
    """A point that shines into a cone around the target."""
    return {
        "type": "spot",
        "to_world": _look_at(mi, position, target, across(np.subtract(target, position))),
        "intensity": even(intensity),
        "cutoff_angle": math.degrees(cone_rad),
        "beam_width": math.degrees(even_rad),
    }


def parallel_light(towards: ArrayLike, irradiance: float) -> dict[str, Any]:
    """Light from far away; `towards` points to it."""
    direction = -np.asarray(towards, dtype=np.float64)
    direction /= np.linalg.norm(direction)
    return {"type": "directional", "direction": direction.tolist(), "irradiance": even(irradiance)}


def surrounding_light(mi: Any, level: float, image: str | None = None) -> dict[str, Any]:
    """An even environment, or one from a picture (latitude–longitude, z up) times the level."""
    if image is None:
        return {"type": "constant", "radiance": even(level)}
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    return {"type": "envmap", "filename": image, "scale": float(level), "to_world": upright}


def surface(mi: Any, mesh: TriangleMesh, bsdf: Mapping[str, Any] | None = None, *, smooth: bool = True) -> Any:
    """A triangle mesh as a shape, its vertex normals smoothing the facets.

    Parameters
    ----------
    mesh
        In the scene's unit.
    bsdf
        Its surface; the tracer follows a body's own interfaces and needs none.
    smooth
        Whether normals are interpolated between vertices; a cut keeps its edges only without.
    """
    properties = mi.Properties()
    if bsdf is not None:
        properties["mesh_bsdf"] = mi.load_dict(dict(bsdf), optimize=False)
    made = mi.Mesh(
        "body",
        len(mesh.vertices),
        len(mesh.faces),
        props=properties,
        has_vertex_normals=smooth,
        has_vertex_texcoords=False,
    )
    data = mi.traverse(made)
    data["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    data["faces"] = mesh.faces.astype(np.uint32).ravel()
    if smooth:
        data["vertex_normals"] = mesh.vertex_normals.astype(np.float32).ravel()
    data.update()
    return made


def thing(
    mi: Any, shape: str, scale: ArrayLike, rotate_rad: ArrayLike, position: ArrayLike, bsdf: Mapping[str, Any]
) -> dict[str, Any]:
    """Another object: a unit shape, scaled, turned about x, then y, then z, and moved."""
    if shape not in SHAPES:
        raise InputError.of("shape", shape, f"must be one of {', '.join(SHAPES)}", "Pick one.")
    matrix = np.eye(4)
    matrix[:3, :3] = turned(rotate_rad) @ np.diag(np.asarray(scale, dtype=np.float64))
    matrix[:3, 3] = np.asarray(position, dtype=np.float64)
    out: dict[str, Any] = {"type": SHAPES[shape], "to_world": mi.ScalarTransform4f(matrix), "bsdf": dict(bsdf)}
    if shape == "cylinder":
        out |= {"p0": [0.0, 0.0, -1.0], "p1": [0.0, 0.0, 1.0], "radius": 1.0}
    return out


def matt(mi: Any, reflectance: Sequence[float]) -> dict[str, Any]:
    """A Lambertian surface, lit on both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _three(mi, reflectance)}}


def metal(mi: Any, reflectance: Sequence[float], roughness: float) -> dict[str, Any]:
    """A mirror times a factor; with a roughness a Beckmann distribution of mirrors."""
    plain: dict[str, Any] = {"type": "conductor", "material": "none", "specular_reflectance": _three(mi, reflectance)}
    if roughness > 0:
        plain |= {"type": "roughconductor", "distribution": "beckmann", "alpha": float(roughness)}
    return {"type": "twosided", "bsdf": plain}


def glass(n: float) -> dict[str, Any]:
    """A clear dielectric."""
    return {"type": "dielectric", "int_ior": float(n), "ext_ior": 1.0}


def turned(angles_rad: ArrayLike) -> FloatArray:
    """Rotation about x, then y, then z.

    >>> (turned([0.0, 0.0, math.pi / 2]) @ [1.0, 0.0, 0.0]).round(12).tolist()
    [0.0, 1.0, 0.0]
    """
    a, b, c = (float(x) for x in np.asarray(angles_rad, dtype=np.float64))
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def across(axis: ArrayLike) -> list[float]:
    """A direction well away from an axis."""
    x, y, z = np.abs(np.asarray(axis, dtype=np.float64))
    return [0.0, 0.0, 1.0] if z <= max(x, y) else [0.0, 1.0, 0.0]


def _three(mi: Any, values: Sequence[float]) -> dict[str, Any]:
    """Values at 700, 546.1 and 435.8 nm, linear between, held beyond; their mean where there is one wavelength only."""
    red, green, blue = (float(v) for v in values)
    if red == green == blue or "mono" in mi.variant():
        return even((red + green + blue) / 3.0)
    nodes = [(VISIBLE_NM[0], blue), *zip(PRIMARIES_NM, (blue, green, red), strict=True), (VISIBLE_NM[1], red)]
    return {"type": "irregular", "wavelengths": _list(w for w, _ in nodes), "values": _list(v for _, v in nodes)}


def _list(values: Any) -> str:
    return ", ".join(f"{v:g}" for v in values)


def _look_at(mi: Any, position: ArrayLike, target: ArrayLike, up: ArrayLike) -> Any:
    origin, aim, above = (np.asarray(x, dtype=float).tolist() for x in (position, target, up))
    return mi.ScalarTransform4f().look_at(origin=origin, target=aim, up=above)


def white_body(
    mi: Any, scene: Mapping[str, Any], meshes: Mapping[str, TriangleMesh], *, spp: int = 16, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """What a white body in the tissue's place would show, and how much of each pixel it fills.

    Parameters
    ----------
    scene
        Camera, lights and other objects.
    meshes
        The body's outer surface by name.

    Returns
    -------
    (row, column) radiance of a Lambertian body of albedo 1 under direct light, and the share of camera rays that meet
    the body first.
    """
    import drjit as dr

    diffuse = {"type": "diffuse", "reflectance": even(1.0)}
    loaded = mi.load_dict(
        {"type": "scene", **scene, **{n: surface(mi, m, diffuse, smooth=False) for n, m in meshes.items()}},
        optimize=False,
    )
    lens = loaded.sensors()[0]
    columns, rows = (int(x) for x in lens.film().crop_size())
    direct = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0 if _pointlike(scene) else 1}
    picture = mi.render(loaded, integrator=mi.load_dict(direct), spp=spp, seed=seed)
    radiance = np.array(picture, dtype=np.float64).reshape(rows, columns, -1)[:, :, 0]
    count = rows * columns * spp
    sampler = mi.load_dict({"type": "independent", "sample_count": spp})
    sampler.seed(seed + 1, count)
    index = dr.arange(mi.UInt32, count) // spp
    place = mi.Point2f(mi.Float(index % columns), mi.Float(index // columns)) + sampler.next_2d()
    ray, _ = lens.sample_ray(mi.Float(0.0), sampler.next_1d(), place / mi.Point2f(columns, rows), sampler.next_2d())
    found = loaded.ray_intersect_preliminary(ray, coherent=True)
    bodies = [s for s in loaded.shapes() if s.id() in meshes]
    mine = mi.Bool(False)
    for body in bodies:
        mine |= found.is_valid() & (found.shape == mi.ShapePtr(body))
    share = np.array(dr.select(mine, mi.Float(1.0), 0.0)).reshape(rows * columns, spp).mean(axis=1)
    return radiance, share.reshape(rows, columns)


def _pointlike(scene: Mapping[str, Any]) -> bool:
    return not any(
        isinstance(x, Mapping) and ("emitter" in x or x.get("type") in ("constant", "envmap")) for x in scene.values()
    )
