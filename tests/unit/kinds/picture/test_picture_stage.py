"""The stage: every light of level 1 makes a white diffuser that faces it just white; things stand where they should."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from livlab.kinds.picture.light import area_radiance, directional_irradiance, point_intensity
from livlab.model.shapes import TriangleMesh, sphere
from livlab.model.tracer import stage
from livlab.model.tracer.variant import mitsuba

LAMP = (120.0, -160.0, 150.0)
EYE = (30.0, -200.0, 40.0)


@pytest.fixture
def mi() -> Any:
    return mitsuba(stage.VARIANT)


def card(towards: tuple[float, float, float], half: float = 0.5) -> TriangleMesh:
    """A small square around the origin that faces a place."""
    n = np.asarray(towards) / np.linalg.norm(towards)
    u = np.cross(n, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    corners = half * np.array([-u - v, u - v, u + v, -u + v])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    made = TriangleMesh(corners, faces)
    return made if float(made.face_normals[0] @ n) > 0 else made.flipped()


def lights(mi: Any) -> dict[str, Any]:
    size = (90.0, 60.0)
    cone = (math.radians(20), math.radians(15))
    return {
        "area": stage.rectangle_light(mi, LAMP, (0, 0, 0), size, area_radiance(1.0, LAMP, size, (0, 0, 0))),
        "point": stage.point_light(LAMP, point_intensity(1.0, LAMP, (0, 0, 0))),
        "spot": stage.spot_light(mi, LAMP, (0, 0, 0), point_intensity(1.0, LAMP, (0, 0, 0)), *cone),
        "directional": stage.parallel_light(LAMP, directional_irradiance(1.0)),
        "environment": stage.surrounding_light(mi, 1.0),
    }


@pytest.mark.parametrize("kind", ["area", "point", "spot", "directional", "environment"])
def test_a_light_of_level_one_makes_a_white_card_just_white(mi: Any, kind: str) -> None:
    sensor = stage.sensor(mi, EYE, (0, 0, 0), (0, 0, 1), math.radians(0.1), 4, 4)
    radiance, share = stage.white_body(
        mi, {"sensor": sensor, "light": lights(mi)[kind]}, {"body": card(LAMP)}, spp=4096
    )
    assert share.min() == 1.0
    # The card is not quite a point: its corners are off by (0.7/250)² of the light.
    assert radiance.mean() == pytest.approx(1.0, abs=2e-3)


def test_a_spot_is_dark_beyond_its_cone(mi: Any) -> None:
    sensor = stage.sensor(mi, EYE, (0, 0, 0), (0, 0, 1), math.radians(0.1), 2, 2)
    cone = (math.radians(4), math.radians(3))
    aside = stage.spot_light(mi, LAMP, (80.0, 0.0, 0.0), 1e5, *cone)
    radiance, _ = stage.white_body(mi, {"sensor": sensor, "light": aside}, {"body": card(LAMP)}, spp=64)
    assert radiance.max() == 0.0


def test_the_picture_is_upright_and_not_mirrored(mi: Any) -> None:
    """Before the camera at −y, a ball at +x and up is seen to the right and above."""
    sensor = stage.sensor(mi, (0, -100, 0), (0, 0, 0), (0, 0, 1), math.radians(30), 40, 20)
    ball = sphere(2.0).moved((15.0, 0.0, 6.0))
    _, share = stage.white_body(
        mi, {"sensor": sensor, "light": stage.surrounding_light(mi, 1.0)}, {"body": ball}, spp=16
    )
    v, u = np.average(np.argwhere(share > 0), axis=0, weights=share[share > 0])
    focal = 20 / math.tan(math.radians(15))
    assert u == pytest.approx(19.5 + focal * 15 / 100, abs=0.2)
    assert v == pytest.approx(9.5 - focal * 6 / 100, abs=0.2)


def test_another_body_in_front_hides_the_tissue(mi: Any) -> None:
    sensor = stage.sensor(mi, (0, -100, 0), (0, 0, 0), (0, 0, 1), math.radians(30), 20, 20)
    screen = stage.thing(mi, "block", (50, 0.1, 50), (0, 0, 0), (50, -50, 0), stage.matt(mi, (0.5, 0.5, 0.5)))
    scene = {"sensor": sensor, "light": stage.surrounding_light(mi, 1.0), "screen": screen}
    _, share = stage.white_body(mi, scene, {"body": sphere(20.0)}, spp=16)
    assert share[:, :9].max() == 1.0
    assert share[:, 11:].max() == 0.0


def test_three_numbers_are_met_at_the_primaries(mi: Any) -> None:
    made = mi.load_dict(stage.matt(mi, (0.08, 0.32, 0.16)))
    si = mi.SurfaceInteraction3f()
    si.wavelengths = mi.Spectrum(700.0, 546.1, 435.8, 800.0)
    si.wi = mi.Vector3f(0, 0, 1)
    found = np.array(made.eval_diffuse_reflectance(si)).ravel()
    assert found == pytest.approx([0.08, 0.32, 0.16, 0.08], rel=1e-4)


def test_rotations_go_about_x_then_y_then_z() -> None:
    quarter = math.pi / 2
    assert stage.turned([quarter, 0, quarter]) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert stage.turned([0, 0, quarter]) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert np.linalg.det(stage.turned([0.3, -0.7, 1.1])) == pytest.approx(1.0)


def test_area_radiance_is_that_of_the_integral() -> None:
    """E = L ∫ cos² / d² dA by a grid of 400² patches."""
    w, h, d = 90.0, 60.0, 80.0
    x, y = np.meshgrid(*((np.arange(400) + 0.5) / 400 * s - s / 2 for s in (w, h)))
    r2 = x**2 + y**2 + d**2
    irradiance = float((d**2 / r2**2).mean() * w * h)
    assert area_radiance(1.0, (0, 0, d), (w, h), (0, 0, 0)) == pytest.approx(math.pi / irradiance, rel=1e-5)
