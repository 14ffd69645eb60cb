"""Long paths: chance that ends them makes no growing variance, and what is given up of them is stated.

In a closed room that reflects ρ and shines E from every place of its walls the radiance is E / (1 − ρ), after k walls
it has the weight ρᵏ: every number here is a closed form. Means are judged within four standard errors, whose size is
bounded.
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
from livlab.model.tracer.lights import Lights
from livlab.model.tracer.objects import LEVEL
from livlab.model.tracer.render import render
from livlab.model.tracer.tracer import Tracer
from livlab.model.tracer.variant import mitsuba

GRID = [460.0, 680.0]
PIXELS = 8
WALLS = (5, 10, 20, 40, 80, 160, 320)


@pytest.fixture(scope="module")
def mi() -> Any:
    return mitsuba("llvm_ad_spectral")


def room(mi: Any, reflectance: float, shines: float = 0.0) -> dict[str, Any]:
    """The inside of a sphere, with a camera in it."""
    walls = {
        "type": "sphere",
        "radius": 1.0,
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": stage.even(reflectance)},
    }
    if shines:
        walls["emitter"] = {"type": "area", "radiance": stage.even(shines)}
    return {
        "type": "scene",
        "sensor": stage.sensor(mi, [0, 0.5, 0.1], [0, 1, 0], [0, 0, 1], 1.0, PIXELS, PIXELS),
        "walls": walls,
    }


class AtWall(Lights):
    """In the place of wavelengths: how many walls a path has met before this one."""

    def seen(self, s: Any, missed: Any, lamp: Any, hit: Any, weight: Any = None) -> list[Any]:
        return [self.dr.select(lamp & (s.bounce.count == k), 1.0, 0.0) for k in WALLS]


def weights_at_walls(mi: Any, reflectance: float, paths: int) -> tuple[Any, Any]:
    """Mean and variance of the weight with which paths meet their k-th wall."""
    tracer = Tracer(room(mi, reflectance), np.linspace(450, 650, len(WALLS)))
    tracer.context.lights = AtWall(tracer.d, tracer.mi, tracer.scene, tracer.wavelengths, tracer.padded)
    total, squares = tracer.launch(paths // PIXELS**2, 1, 1, 0)
    mean = total.sum(axis=0) / paths
    return mean, squares.sum(axis=0) / paths - mean**2


@pytest.mark.parametrize("reflectance", [0.9, 0.99, 1.0])
def test_the_variance_of_a_path_does_not_grow_with_the_walls_it_meets(mi: Any, reflectance: float) -> None:
    paths = 1 << 16
    mean, variance = weights_at_walls(mi, reflectance, paths)
    wanted = reflectance ** np.array(WALLS)
    # Below the level a path that is left weighs the level: it is left with chance ρᵏ / level.
    spread = np.where(wanted < LEVEL, wanted * (LEVEL - wanted), 0.0)
    assert np.all(np.abs(mean - wanted) <= 4 * np.sqrt(spread / paths) + 1e-4)
    chance = np.minimum(wanted / LEVEL, 1.0)
    error = np.sqrt(np.maximum(chance * (1 - chance) * (1 - 2 * chance) ** 2 / paths, 0.0)) * LEVEL**2
    assert np.all(np.abs(variance - spread) <= 4 * error + 1e-4)
    # A path ended at full weight with a chance of 1 in 20 had 0.05 at 5 walls, 5 at 40 and 3000 at 160 (ρ = 1).
    assert variance.max() <= LEVEL**2 / 4 * 1.05


@pytest.mark.parametrize("reflectance", [0.5, 0.9, 0.99])
def test_a_closed_room_that_shines_is_as_bright_as_its_walls_light_each_other(mi: Any, reflectance: float) -> None:
    found = render(room(mi, reflectance, 1.0), GRID, spp=512, seed=4)
    wanted = 1.0 / (1.0 - reflectance)
    error = np.sqrt(np.square(found["radiance_se"]).sum(["row", "column"])).to_numpy() / PIXELS**2
    assert np.all(error < 0.003 * wanted)
    assert np.all(np.abs(found["radiance"].mean(["row", "column"]).to_numpy() - wanted) < 4 * error)
    assert float(found["systematic"].max()) < 0.01 * wanted


def test_everything_in_a_white_room_is_as_bright_as_its_black_lamp(mi: Any) -> None:
    # B = ρ f π E / (1 − ρ (1 − f)), f = (r / R)² the lamp's share of what walls send out: at ρ = 1 it is π E.
    for reflectance, wanted in ((1.0, 1.0), (0.8, 0.8 * 0.09 / (1.0 - 0.8 * 0.91))):
        scene = room(mi, reflectance)
        scene["lamp"] = {
            "type": "sphere",
            "radius": 0.3,
            "bsdf": {"type": "diffuse", "reflectance": stage.even(0.0)},
            "emitter": {"type": "area", "radiance": stage.even(1.0)},
        }
        found = render(scene, GRID, spp=2048, seed=2)
        error = np.sqrt(np.square(found["radiance_se"]).sum(["row", "column"])).to_numpy() / PIXELS**2
        assert np.all(error < 0.003 * wanted)
        assert np.all(np.abs(found["radiance"].mean(["row", "column"]).to_numpy() - wanted) < 4 * error)
        assert found.attrs["given_up"] == 0 and not found["systematic"].any()


@pytest.mark.parametrize(("reflectance", "walls"), [(0.9, 5), (0.99, 100), (0.999, 300)])
def test_what_paths_given_up_lack_is_stated(mi: Any, reflectance: float, walls: int) -> None:
    found = render(room(mi, reflectance, 1.0), GRID, spp=64, seed=4, max_bounces=walls)
    lacks = 1.0 / (1.0 - reflectance) - found["radiance"].mean().item()
    told = found["systematic"].mean().item()
    assert lacks > 0.2 * found["radiance"].mean().item()
    assert lacks <= told + 4 * found["radiance_se"].mean().item() <= 1.15 * lacks
    (note,) = found.attrs["notes"].splitlines()
    assert f"given up after {walls} objects hit" in note and "raise max_bounces" in note


def test_light_that_does_not_fade_has_no_bound(mi: Any) -> None:
    found = render(room(mi, 1.0, 1.0), GRID, spp=16, seed=4, max_bounces=50)
    assert np.isposinf(found["systematic"].to_numpy()).all()
    assert "nobody can tell" in found.attrs["notes"]


@pytest.mark.parametrize("lit", ["around", "point"])
def test_paths_given_up_inside_a_body_are_stated_too(mi: Any, lit: str) -> None:
    stack = plain_stack([(1.4, 0.0, 5.0, 1e3, HenyeyGreenstein(0.5))]).at([0, 0])
    body = Body(replace(stack, wavelength_nm=np.array(GRID)), "ball")
    scene = {
        "type": "scene",
        "sensor": stage.sensor(mi, [0, -20, 0], [0, 0, 0], [0, 0, 1], 0.1, PIXELS, PIXELS),
        "ball": {"type": "sphere", "radius": 3.0},
        "around": stage.surrounding_light(mi, 1.0) if lit == "around" else stage.point_light([0, -20, 5], 2000.0),
    }
    found = render(scene, GRID, body=body, spp=64, seed=4, max_steps=100)
    whole = render(scene, GRID, body=body, spp=64, seed=5)
    assert whole.attrs["given_up"] == 0 and not whole["systematic"].any() and not whole.attrs["notes"]
    lacks = (whole["radiance"] - found["radiance"]).mean().item()
    error = np.sqrt((whole["radiance_se"] ** 2 + found["radiance_se"] ** 2).sum().item()) / found["radiance"].size
    assert lacks > 10 * error and error < 0.02 * whole["radiance"].mean().item()
    assert lacks <= found["systematic"].mean().item() + 4 * error
    assert found["systematic"].mean().item() < 20 * lacks
    assert f"{found.attrs['given_up']} of {64 * PIXELS**2} paths were given up after 100 steps" in found.attrs["notes"]


def test_a_picture_gone_on_with_knows_what_was_given_up_before(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("livlab.model.tracer.render.LAUNCH_PATHS", PIXELS**2 * 16)
    kept: list[Any] = []
    scene = room(mi, 0.9, 1.0)
    whole = render(scene, GRID, spp=64, seed=4, max_bounces=5, checkpoint=kept.append)
    again = render(scene, GRID, spp=64, seed=4, max_bounces=5, resume=kept[1])
    np.testing.assert_array_equal(again["systematic"], whole["systematic"])
    assert again.attrs["notes"] == whole.attrs["notes"]


def test_more_paths_given_up_than_sixteen_bits_hold_are_counted(mi: Any) -> None:
    scene = room(mi, 0.9, 1.0) | {"sensor": stage.sensor(mi, [0, 0, 0], [0, 1, 0], [0, 0, 1], 1.0, 1, 1)}
    tracer = Tracer(scene, np.array(GRID), max_bounces=1)
    tracer.launch(1, 1 << 17, 0, 0)
    assert tracer.troubles == {"given_up": 1 << 17, "strayed": 0}
    taken = tracer.take_given_up()
    np.testing.assert_allclose(taken.weight, 0.9 * (1 << 17), rtol=2e-3)


def test_an_instruments_reading_lacks_no_more_than_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    from livlab.acquire.instruments.collinear import Collinear
    from livlab.acquire.instruments.solvers import TracerSolver
    from livlab.acquire.instruments.spectrometer import measure
    from livlab.model.tracer import block

    stack = plain_stack([(1.4, 0.01, 5.0, 1e3, HenyeyGreenstein(0.5))])
    solver = TracerSolver(samples=1 << 16, seed=3)
    whole = measure(stack, Collinear(), solver)
    assert not whole["systematic"].any() and "given up" not in whole.attrs["notes"]
    made = block.Tracer
    monkeypatch.setattr(block, "Tracer", lambda *a, **k: made(*a, **k, max_steps=60))
    short = measure(stack, Collinear(), solver)
    lacks = (whole["value"] - short["value"]).item()
    error = np.hypot(whole["standard_error"], short["standard_error"]).item()
    told = short["systematic"].item()
    assert lacks > 5 * error
    assert lacks <= told + 4 * error and "stated as systematic" in short.attrs["notes"]
