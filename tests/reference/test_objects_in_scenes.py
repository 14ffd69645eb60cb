"""Other objects in a scene, against Mitsuba's own path tracer wavelength by wavelength, and in a white furnace.

Both follow the same lights and reflection models; Mitsuba's `path` is asked for four wavelengths of our choice, so
that no colour conversion stands between. Pictures agree within four standard errors in the mean, whose size is bounded,
and their pixels scatter about each other as their errors say (reduced χ²).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import plain_stack
from livlab.model.tracer import stage
from livlab.model.tracer.body import Body
from livlab.model.tracer.render import render
from livlab.model.tracer.variant import mitsuba

GRID = [460.0, 530.0, 600.0, 680.0]
PIXELS = 12


@pytest.fixture(scope="module")
def mi() -> Any:
    return mitsuba("llvm_ad_spectral")


def coloured(*values: float) -> dict[str, Any]:
    return {"type": "irregular", "wavelengths": "400,500,600,750", "values": ",".join(map(str, values))}


RED = {"type": "diffuse", "reflectance": coloured(0.05, 0.1, 0.7, 0.8)}
GREEN = {"type": "diffuse", "reflectance": coloured(0.1, 0.7, 0.2, 0.1)}
GREY = {"type": "diffuse", "reflectance": stage.even(0.6)}
MODELS: dict[str, dict[str, Any]] = {
    "diffuse": RED,
    "plastic": {"type": "plastic", "diffuse_reflectance": coloured(0.1, 0.3, 0.5, 0.7)},
    "rough plastic": {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": coloured(0.6, 0.3, 0.2, 0.1)},
    "mirror": {"type": "conductor", "specular_reflectance": coloured(0.9, 0.8, 0.6, 0.5)},
    "rough metal": {"type": "roughconductor", "alpha": 0.3, "specular_reflectance": coloured(0.9, 0.8, 0.6, 0.5)},
    "two sides": {"type": "twosided", "nested": GREEN},
    "glass": {"type": "dielectric", "int_ior": 1.5},
    "principled": {"type": "principled", "base_color": coloured(0.6, 0.3, 0.2, 0.1), "roughness": 0.4, "metallic": 0.3},
    "blend": {"type": "blendbsdf", "weight": 0.4, "a": RED, "b": {"type": "roughconductor", "alpha": 0.3}},
}
LIGHTS: dict[str, Any] = {
    "area": lambda mi: stage.rectangle_light(mi, [1, 1, 3.5], [0, 0, 0], [1.2, 1.2], 6.0),
    "area that reflects": lambda mi: (
        stage.rectangle_light(mi, [1, 1, 3.5], [0, 0, 0], [1.2, 1.2], 6.0) | {"bsdf": GREY}
    ),
    "point": lambda mi: {"type": "point", "position": [1, -1, 3], "intensity": coloured(8, 9, 12, 14)},
    "around": lambda mi: stage.surrounding_light(mi, 0.7),
    "parallel": lambda mi: stage.parallel_light([0.3, -0.4, 1.0], 2.0),
}


def room(mi: Any, model: dict[str, Any], lights: list[str]) -> dict[str, Any]:
    """A ball of the model on a floor by a wall."""
    t = mi.ScalarTransform4f
    wall = t().translate([-1.6, 0, 1]) @ t().rotate([0, 1, 0], 90) @ t().scale([2, 2, 1])
    return {
        "type": "scene",
        "sensor": stage.sensor(mi, [3, -5, 2.2], [-0.3, 0, 0.8], [0, 0, 1], 0.7, PIXELS, PIXELS),
        "floor": {"type": "rectangle", "to_world": t().scale([3, 3, 1]), "bsdf": GREY},
        "wall": {"type": "rectangle", "to_world": wall, "bsdf": RED},
        "ball": {"type": "sphere", "center": [0, 0, 0.9], "radius": 0.8, "bsdf": model},
        **{name: LIGHTS[name](mi) for name in lights},
    }


def theirs(mi: Any, scene: dict[str, Any], spp: int, seed: int, kind: str = "path") -> tuple[Any, Any]:
    """Mitsuba's own integrator at the wavelengths of the grid: (row, column, W) mean and standard error."""
    import drjit as dr

    world = mi.load_dict(scene, optimize=False)
    path = mi.load_dict({"type": kind, "max_depth": -1, "rr_depth": 1000 if kind == "volpath" else 8})
    sampler = mi.load_dict({"type": "independent"})
    n = PIXELS * PIXELS * spp
    sampler.seed(seed, n)
    pixel = dr.arange(mi.UInt32, n) // spp
    row = pixel // PIXELS
    place = (mi.Point2f(mi.Float(pixel - row * PIXELS), mi.Float(row)) + sampler.next_2d()) / PIXELS
    ray, _ = world.sensors()[0].sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
    ray.wavelengths = mi.UnpolarizedSpectrum(*GRID)
    found = np.array(path.sample(world, sampler, mi.RayDifferential3f(ray))[0]).reshape(4, -1, spp).astype(float)
    mean, error = found.mean(axis=-1), found.std(axis=-1, ddof=1) / np.sqrt(spp)
    return mean.T.reshape(PIXELS, PIXELS, 4), error.T.reshape(PIXELS, PIXELS, 4)


def agree(mi: Any, scene: dict[str, Any], spp: int, power: float, body: Body | None = None, other: Any = None) -> None:
    """Ours and theirs (of `other`, if that differs), within four standard errors that are at most `power` of it."""
    ours = render(scene, GRID, body=body, spp=spp, seed=3)
    value, error = ours["radiance"].to_numpy(), ours["radiance_se"].to_numpy()
    wanted, their_error = theirs(mi, other or scene, spp, 5, "path" if body is None else "volpath")
    assert ours.attrs["given_up"] == 0
    both = np.hypot(error, their_error)
    total = np.sqrt((both**2).sum(axis=(0, 1))) / PIXELS**2
    mean = wanted.mean(axis=(0, 1))
    assert np.all(total <= power * mean), total / mean
    assert np.all(np.abs(value.mean(axis=(0, 1)) - mean) <= 4 * total), (value.mean(axis=(0, 1)) - mean) / total
    z = (value - wanted)[both > 0] / both[both > 0]
    assert np.abs(value - wanted)[both == 0].max(initial=0.0) < 1e-5
    assert np.mean(np.minimum(z * z, 25.0)) < 1.5, np.mean(z * z)


@pytest.mark.parametrize("name", MODELS)
def test_every_model_under_all_lights_is_mitsubas(mi: Any, name: str) -> None:
    agree(mi, room(mi, MODELS[name], ["area", "point", "around", "parallel"]), 1024, power=0.008)


@pytest.mark.parametrize("light", LIGHTS)
def test_every_light_alone_is_mitsubas(mi: Any, light: str) -> None:
    agree(mi, room(mi, MODELS["plastic"], [light]), 1024, power=0.008)


def test_a_wall_colours_tissue_beside_it_as_in_mitsubas_volume_tracer(mi: Any) -> None:
    scattering, absorption = 1.5, 0.1
    inside = {
        "type": "homogeneous",
        "albedo": stage.even(scattering / (scattering + absorption)),
        "sigma_t": stage.even(scattering + absorption),
        "phase": {"type": "hg", "g": 0.5},
    }
    lights = {
        # Large, for Mitsuba's paths find it only by chance from within the ball.
        "area": stage.rectangle_light(mi, [1, 1, 4], [0, 0, 0], [4, 4], 1.5),
        "around": stage.surrounding_light(mi, 0.3),
    }
    ours = room(mi, GREY, []) | lights
    glass = {"type": "dielectric", "int_ior": 1.4, "ext_ior": 1.0}
    other = ours | {"ball": {**ours["ball"], "bsdf": glass, "interior": inside}}
    stack = plain_stack([(1.4, absorption, scattering, 1e3, HenyeyGreenstein(0.5))]).at([0, 0, 0, 0])
    body = Body(replace(stack, wavelength_nm=np.array(GRID)), "ball")
    agree(mi, ours, 1024, 0.008, body, other)


def test_a_convex_object_in_even_light_shows_its_reflectance(mi: Any) -> None:
    scene = room(mi, RED, ["around"])
    for name in ("floor", "wall"):
        del scene[name]
    scene["sensor"] = stage.sensor(mi, [0, -5, 0.9], [0, 0, 0.9], [0, 0, 1], 0.1, 4, 4)
    found = render(scene, GRID, spp=2048, seed=1)
    wanted = 0.7 * np.interp(GRID, [400, 500, 600, 750], [0.05, 0.1, 0.7, 0.8])
    value, error = found["radiance"].to_numpy(), found["radiance_se"].to_numpy()
    total = np.sqrt((error**2).sum(axis=(0, 1))) / 16
    assert np.all(total < 0.004 * wanted)
    assert np.all(np.abs(value.mean(axis=(0, 1)) - wanted) < 4 * total)
    # One path, four wavelengths: their ratios have no noise.
    np.testing.assert_allclose(value / value[..., :1], wanted / wanted[0] * np.ones((4, 4, 1)), rtol=1e-5)


def test_white_things_and_white_tissue_cannot_be_told_from_even_light(mi: Any) -> None:
    one = {"type": "diffuse", "reflectance": stage.even(1.0)}
    scene = room(mi, one, []) | {"around": stage.surrounding_light(mi, 1.0)}
    scene["floor"]["bsdf"] = scene["wall"]["bsdf"] = one
    stack = plain_stack([(1.4, 0.0, 3.0, 1e3, HenyeyGreenstein(0.7))]).at([0, 0, 0, 0])
    found = render(scene, GRID, body=Body(replace(stack, wavelength_nm=np.array(GRID)), "ball"), spp=512, seed=2)
    error = found["radiance_se"].to_numpy()
    away = found["radiance"].to_numpy() - 1.0
    total = np.sqrt((error**2).sum(axis=(0, 1))) / PIXELS**2
    assert total.max() < 0.002
    assert np.abs(away.mean(axis=(0, 1)) / total).max() < 4
    assert np.abs(away / np.maximum(error, 1e-4)).max() < 5  # 144 pixels, the wavelengths go together


def test_a_lamp_in_a_mirror_is_as_bright_as_itself(mi: Any) -> None:
    t = mi.ScalarTransform4f
    scene = {
        "type": "scene",
        "sensor": stage.sensor(mi, [0, -4, 4], [0, 0, 0], [0, 0, 1], 0.05, 4, 4),
        "floor": {"type": "rectangle", "to_world": t().scale([3, 3, 1]), "bsdf": {"type": "conductor"}},
        "lamp": stage.rectangle_light(mi, [0, 4, 4], [0, 0, 0], [2, 2], 6.0),
    }
    np.testing.assert_allclose(render(scene, GRID, spp=64)["radiance"].to_numpy(), 6.0, rtol=1e-5)
