"""Next-event estimation through a refracting surface, against paths that hit lamps by chance and against beams.

Differences are held within four standard errors whose size, as part of the value, is bounded.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from livlab.model.shapes import box, distance_field, sphere
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.model.tracer import stage
from livlab.model.tracer.body import Body
from livlab.model.tracer.tracer import Tracer
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.adding_doubling import adding_doubling, exit_flux

THIN = plain_stack([(1.4, 0.1, 1.5, 1e3, HenyeyGreenstein(0.5))])
DENSE = plain_stack([(1.4, 1.0, 20.0, 1e3, HenyeyGreenstein(0.5))])
LAYERS = plain_stack([(1.36, 0.1, 10.0, 0.05, HenyeyGreenstein(0.8)), (1.45, 1.0, 15.0, 50.0, HenyeyGreenstein(0.8))])
# So dense that no light comes from where a lamp of some extent is left to chance.
DENSER = plain_stack([(1.4, 5.0, 80.0, 1e3, HenyeyGreenstein(0.5))])
FINE = plain_stack([(1.36, 1.0, 50.0, 0.02, HenyeyGreenstein(0.8)), (1.45, 10.0, 80.0, 50.0, HenyeyGreenstein(0.8))])
BULK = plain_stack([(1.5, 1.0, 9.0, 1e3, Isotropic())])


@pytest.fixture(scope="module")
def mi() -> Any:
    return mitsuba("llvm_ad_spectral")


def mean(scene: dict[str, Any], body: Body, spp: int, seed: int, *, next_event: bool = True) -> tuple[float, float]:
    """Mean over the picture and its standard error; without next-event estimation, lamps are hit by chance alone."""
    tracer = Tracer(scene, body.stack.wavelength_nm, body, next_event=next_event)
    rows = spp // 16
    total, squares = tracer.launch(rows, 16, seed, 0)
    assert tracer.troubles["given_up"] == 0
    value = total / rows
    variance = np.maximum(squares / rows - value**2, 0.0) / (rows - 1)
    return float(value.mean()), float(np.sqrt(variance.sum()) / value.size)


def view(mi: Any, lights: dict[str, Any], shapes: dict[str, Any]) -> dict[str, Any]:
    eye = stage.sensor(mi, [3, -5, 2.2], [0, 0, 0.9], [0, 0, 1], 0.4, 10, 10)
    return {"type": "scene", "sensor": eye, **shapes, **lights}


def ball(radius: float = 0.8) -> dict[str, Any]:
    return {"type": "sphere", "center": [0, 0, 0.9], "radius": radius}


def bodies(mi: Any, kind: str) -> tuple[dict[str, Any], Body]:
    plain = {"thin": THIN, "dense": DENSE, "denser": DENSER}
    if kind in plain:
        return {"ball": ball()}, Body(plain[kind], "ball")
    if kind == "nested":
        return {"ball": ball(), "core": ball(0.75)}, Body(LAYERS, ("ball", "core"))
    mesh = sphere(0.8, (0.0, 0.0, 0.9), resolution_mm=0.08)
    field = distance_field(mesh, 0.04)
    stack = {"mesh": DENSE, "thin mesh": THIN, "depth": LAYERS, "fine": FINE}[kind]
    return {"ball": stage.surface(mi, mesh)}, Body(stack, "ball", field)


SLOW = [pytest.param(kind, marks=pytest.mark.slow) for kind in ("mesh", "thin mesh")]


@pytest.mark.parametrize("kind", ["thin", "dense", "nested", "depth", *SLOW])
def test_a_sampled_lamp_is_as_bright_as_one_hit_by_chance(mi: Any, kind: str) -> None:
    shapes, body = bodies(mi, kind)
    lamp = {"lamp": stage.rectangle_light(mi, [1, 1, 4], [0, 0, 0], [4, 4], 1.5)}
    scene = view(mi, lamp, shapes)
    sampled, hit = mean(scene, body, 8192, 1), mean(scene, body, 32768, 2, next_event=False)
    error = float(np.hypot(sampled[1], hit[1]))
    assert error < 0.015 * hit[0], error / hit[0]
    assert abs(sampled[0] - hit[0]) < 4 * error, (sampled[0] - hit[0]) / error


def test_lamps_among_each_other_and_even_light_add_up(mi: Any) -> None:
    shapes, body = bodies(mi, "dense")
    lights = {
        "one": stage.rectangle_light(mi, [1, 1, 4], [0, 0, 0], [2, 2], 1.5),
        "two": stage.point_light([-1, -3, 2], 4.0),
        "three": stage.parallel_light([0, -1, 1], 0.5),
        "four": stage.surrounding_light(mi, 0.2),
    }
    # The lamp hides some of the even light.
    shaded = {**shapes, "shade": {k: v for k, v in lights["one"].items() if k != "emitter"}}
    together = mean(view(mi, lights, shapes), body, 8192, 1)
    alone = [view(mi, {k: v}, shapes if k == "one" else shaded) for k, v in lights.items()]
    parts = [mean(scene, body, 8192, 2 + i) for i, scene in enumerate(alone)]
    error = float(np.sqrt(together[1] ** 2 + sum(p[1] ** 2 for p in parts)))
    whole = sum(p[0] for p in parts)
    assert error < 0.01 * whole, error / whole
    assert abs(together[0] - whole) < 4 * error, (together[0] - whole) / error


@pytest.mark.parametrize("kind", ["denser", "fine"])
def test_a_small_lamp_is_a_point(mi: Any, kind: str) -> None:
    shapes, body = bodies(mi, kind)
    place, seen, side, radiance = [1.0, -1.5, 3.0], [0.08, -0.48, 1.53], 0.02, 1e4
    small = {"lamp": stage.rectangle_light(mi, place, seen, [side, side], radiance)}
    point = {"lamp": stage.point_light(place, radiance * side**2)}
    # Beside the small lamp's highlight, which a point has not.
    eye = stage.sensor(mi, [3, -5, 2.2], seen, [0, 0, 1], 0.04, 4, 4)
    scenes = [view(mi, lamp, shapes) | {"sensor": eye} for lamp in (small, point)]
    one, other = (mean(scene, body, 32768, 1 + k) for k, scene in enumerate(scenes))
    error = float(np.hypot(one[1], other[1]))
    assert error < 0.015 * other[0], error / other[0]
    assert abs(one[0] - other[0]) < 4 * error, (one[0] - other[0]) / error


@pytest.mark.parametrize("angle_deg", [0.0, 50.0])
def test_a_point_far_away_is_a_beam(mi: Any, angle_deg: float) -> None:
    mesh = box((80.0, 80.0, 20.0), (0.0, 0.0, -10.0))
    a, far = np.radians(angle_deg), 4000.0
    place = far * np.array([np.sin(a), 0.0, np.cos(a)])
    scene = {
        "type": "scene",
        "sensor": stage.sensor(mi, [0, 0, 500], [0, 0, 0], [0, 1, 0], 0.002, 4, 4),
        "block": stage.surface(mi, mesh, smooth=False),
        "lamp": stage.point_light(place, far**2),
    }
    value, error = mean(scene, Body(BULK, "block"), 8192, 1)
    incident = float(np.cos(a))
    flux = exit_flux(adding_doubling(BULK, mu0=incident), 1.0).to_numpy().ravel()[0]
    wanted = flux * incident
    assert error < 0.01 * wanted, error / wanted
    assert abs(value - wanted) < 4 * error, (value - wanted) / error


def test_no_lamp_shines_through_what_is_in_its_way(mi: Any) -> None:
    shapes, body = bodies(mi, "dense")
    plate = stage.thing(
        mi, "block", [3, 3, 0.05], [0, 0, 0], [0, 0, 2.5], {"type": "diffuse", "reflectance": stage.even(0)}
    )
    lamps = {"lamp": stage.point_light([0, 0, 4], 4.0), "beam": stage.parallel_light([0, 0, 1], 1.0)}
    scene = view(mi, lamps, {**shapes, "plate": plate})
    scene["sensor"] = stage.sensor(mi, [0, -6, 0.9], [0, 0, 0.9], [0, 0, 1], 0.2, 4, 4)
    assert mean(scene, body, 256, 1)[0] == 0.0
