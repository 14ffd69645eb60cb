"""Rays at a body's edges, corners and outline: no light leaks in or out there, and no path is given up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from livlab.model.shapes import box, distance_field, liver, sphere
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.presets import load_preset
from livlab.model.tissue.readings import READINGS
from livlab.model.tissue.stack import plain_stack
from livlab.model.tracer import stage
from livlab.model.tracer.body import Body
from livlab.model.tracer.render import render
from livlab.model.tracer.tracer import Tracer
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.rng import uniform

MATCHED = plain_stack([(1.0, 0.0, 3.0, 1e3, HenyeyGreenstein(0.7))])
WHITE = plain_stack([(1.4, 0.0, 3.0, 1e3, HenyeyGreenstein(0.7))])
LAYERED = plain_stack([(1.4, 0.0, 3.0, 0.1, HenyeyGreenstein(0.7)), (1.5, 0.0, 5.0, 1e3, HenyeyGreenstein(0.7))])


@pytest.fixture(scope="module")
def mi() -> Any:
    return mitsuba("llvm_ad_spectral")


def aimed(targets: Any, spread: float) -> Any:
    """Rays from afar, from all sides, at one target a pixel, off it by a random part of `spread`."""
    where = np.asarray(targets, dtype=np.float32)

    def rays(d: Any, mi: Any) -> Any:
        dr = d.dr
        places = [d.load(mi.Float, where[:, k]) for k in range(3)]
        dr.make_opaque(*places)

        def cast(stream: Any, pixel: Any) -> tuple[Any, Any]:
            def draw() -> Any:
                return uniform(d, stream.next_uint32())

            target = mi.Point3f(*(dr.gather(mi.Float, x, pixel) for x in places))
            off = mi.Vector3f(*(spread * (2.0 * draw() - 1.0) for _ in range(3)))
            back = mi.warp.square_to_uniform_sphere(mi.Point2f(draw(), draw()))
            return target + off + 50.0 * back, -back

        return cast

    return rays


def furnace(mi: Any, mesh: Any, stack: Any, targets: Any, spread: float, rows: int) -> tuple[Any, Any, Tracer]:
    """(pixel,) mean radiance and its error under even light of 1."""
    scene = {
        "type": "scene",
        "body": stage.surface(mi, mesh, smooth=False),
        "light": stage.surrounding_light(mi, 1.0),
    }
    field = distance_field(mesh, 0.25) if len(stack.layers) > 1 else None
    tracer = Tracer(
        scene,
        stack.wavelength_nm,
        Body(stack, "body", field),
        rays=aimed(targets, spread),
        shape=(1, len(targets)),
    )
    total, squares = tracer.launch(rows, 8, 1, 0)
    mean = total[:, 0] / rows
    return mean, np.sqrt(np.maximum(squares[:, 0] / rows - mean**2, 0.0) / (rows - 1)), tracer


def places(mesh: Any) -> Any:
    """Corners and middles of edges."""
    corners = mesh.vertices
    ends = np.concatenate([mesh.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    edges = np.unique(np.sort(ends, axis=1), axis=0)
    return np.concatenate([corners, corners[edges].mean(axis=1)])


@pytest.mark.parametrize("spread", [0.0, 1e-6, 1e-3])
@pytest.mark.parametrize("body", ["ball", "box"])
def test_no_light_is_lost_at_edges_and_corners(mi: Any, body: str, spread: float) -> None:
    mesh = sphere(2.0, resolution_mm=2.0) if body == "ball" else box((4.0, 3.0, 2.0))
    targets = places(mesh)
    # Without an index every path ends in the light of 1: no noise, so that each pixel must be 1 itself.
    mean, _, tracer = furnace(mi, mesh, MATCHED, targets, spread, 64)
    np.testing.assert_allclose(mean, 1.0, atol=2e-4)
    assert tracer.troubles["given_up"] == 0


@pytest.mark.parametrize("stack", [WHITE, LAYERED], ids=["one layer", "layers by depth"])
@pytest.mark.parametrize("body", ["ball", "box"])
def test_nor_where_the_surface_reflects(mi: Any, body: str, stack: Any) -> None:
    mesh = sphere(2.0, resolution_mm=2.0) if body == "ball" else box((4.0, 3.0, 2.0))
    mean, error, tracer = furnace(mi, mesh, stack, places(mesh), 1e-6, 1024)
    assert tracer.troubles["given_up"] == 0
    assert np.median(error) < 0.01
    z = (mean - 1.0) / error
    assert np.abs(z).max() < 4.5, z  # up to 200 pixels
    whole = float(np.sqrt((error**2).sum()) / len(error))
    assert abs(mean.mean() - 1.0) < 4 * whole, (mean.mean() - 1.0) / whole


@pytest.mark.parametrize("smooth", [True, False])
def test_no_path_is_given_up_at_the_outline_of_a_liver(mi: Any, smooth: bool) -> None:
    mesh = liver(resolution_mm=2.0)
    stack = optical_stack(load_preset("liver", variant="parenchyma_only"), READINGS["thesis"], [546.1, 700.0])
    scene = {
        "type": "scene",
        "sensor": stage.sensor(mi, [-20, -330, 40], [0, 0, 0], [0, 0, 1], 0.52, 160, 90),
        "body": stage.surface(mi, mesh, smooth=smooth),
        "light": stage.surrounding_light(mi, 1.0),
    }
    found = render(scene, stack.wavelength_nm, body=Body(stack, "body", distance_field(mesh, 2.0)), spp=16, seed=1)
    assert found.attrs["given_up"] == 0
    assert found.attrs["strayed"] < 1e-4 * 160 * 90 * 16
    assert 0.5 < float(found["radiance"].mean()) < 1.0  # dark liver before light of 1
