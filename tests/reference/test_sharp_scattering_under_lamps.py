"""A lamp on a capsule that scatters sharply forward at free paths of a few µm, as the `measured` reading's does.

Such a layer shows what blunter ones hide: a lamp's light comes through its free paths only if the way to the surface is
known to a small part of them, and towards a lamp its phase function has no useful bound.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from livlab.model.shapes import TriangleMesh, box, distance_field, sphere
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import OpticalStack, plain_stack
from livlab.model.tracer import stage
from livlab.model.tracer.body import Body
from livlab.model.tracer.tracer import Tracer
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.adding_doubling import adding_doubling, exit_flux

BULK = (1.38, 0.1, 8.0, 140.0, HenyeyGreenstein(0.9))
RADIUS = 20.0


@pytest.fixture(scope="module")
def mi() -> Any:
    return mitsuba("llvm_ad_spectral")


def coated(g: float) -> OpticalStack:
    """Free paths of 5 µm in a capsule of 85 µm."""
    return plain_stack([(1.35, 0.0, 200.0, 0.085, HenyeyGreenstein(g)), BULK])


def mean(scene: dict[str, Any], body: Body, spp: int, seed: int, *, next_event: bool = True) -> tuple[float, float]:
    """Mean over the picture and its standard error; without next-event estimation, lamps are hit by chance alone."""
    tracer = Tracer(scene, body.stack.wavelength_nm, body, next_event=next_event)
    total, squares = tracer.launch(spp, 1, seed, 0)
    value = total / spp
    variance = np.maximum(squares / spp - value**2, 0.0) / (spp - 1)
    return float(value.mean()), float(np.sqrt(variance.sum()) / value.size)


@pytest.fixture(scope="module")
def ball() -> tuple[TriangleMesh, Any]:
    """Facets of 2 mm: by their edges a depth told by grid and tangent plane is off by some µm."""
    mesh = sphere(RADIUS, (0.0, 0.0, 0.0), resolution_mm=2.0)
    return mesh, distance_field(mesh, 0.5)


@pytest.mark.parametrize("g", [0.95, 0.99])
def test_a_sampled_lamp_on_a_curved_body_is_one_hit_by_chance(
    mi: Any, ball: tuple[TriangleMesh, Any], g: float
) -> None:
    mesh, field = ball
    scene = {
        "type": "scene",
        "sensor": stage.sensor(mi, [0, -6 * RADIUS, 0], [0, 0, 0], [0, 0, 1], 0.25, 8, 8),
        "ball": stage.surface(mi, mesh),
        "lamp": stage.rectangle_light(
            mi, [-1.5 * RADIUS, -2 * RADIUS, 2 * RADIUS], [0, 0, 0], [5 * RADIUS, 5 * RADIUS], 1.0
        ),
    }
    body = Body(coated(g), "ball", field)
    sampled, hit = mean(scene, body, 8192, 1), mean(scene, body, 8192, 2, next_event=False)
    error = float(np.hypot(sampled[1], hit[1]))
    assert error < 0.008 * hit[0], error / hit[0]
    assert abs(sampled[0] - hit[0]) < 4 * error, (sampled[0] - hit[0]) / error


def test_on_flat_layers_a_lamp_is_as_bright_as_adding_doubling_has_it(mi: Any) -> None:
    stack = coated(0.99)
    mesh = box((80.0, 80.0, 30.0), (0.0, 0.0, -15.0))
    high, widest, eye = 400.0, np.radians(35.0), np.radians(60.0)
    # Around the normal, so that no azimuth matters; the eye sees neither the lamp nor its mirror image.
    wide = high * float(np.tan(widest))
    t = mi.ScalarTransform4f
    lamp = {
        "type": "disk",
        "to_world": t().translate([0, 0, high]) @ t().rotate([1, 0, 0], 180) @ t().scale([wide, wide, 1]),
        "bsdf": {"type": "diffuse", "reflectance": stage.even(0.0)},
        "emitter": {"type": "area", "radiance": stage.even(1.0)},
    }
    place = 300.0 * np.array([np.sin(eye), 0.0, np.cos(eye)])
    scene = {
        "type": "scene",
        "sensor": stage.sensor(mi, place, [0, 0, 0], [0, 1, 0], 0.002, 2, 2),
        "block": stage.surface(mi, mesh, smooth=False),
        "lamp": lamp,
    }
    value, error = mean(scene, Body(stack, "block", distance_field(mesh, 0.5)), 65536, 3)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    out, edge = float(np.cos(eye)), float(np.cos(widest))
    wanted = 0.0
    for x, weight in zip(nodes, weights, strict=True):
        mu = 0.5 * (1 + edge + (1 - edge) * x)
        seen = exit_flux(adding_doubling(stack, mu0=float(mu)), out).to_numpy().ravel()[0] / out
        wanted += np.pi * (1 - edge) * weight * mu * seen
    assert error < 0.0085 * wanted, error / wanted
    assert abs(value - wanted) < 4 * error, (value - wanted) / error
