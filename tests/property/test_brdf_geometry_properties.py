"""Angles, frames and cameras: closed forms, and round trips over everything they may be given."""

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from livlab.brdf.angles import direction, from_half_angles, half_angles, local_frames, polar_angle, unit_directions
from livlab.brdf.geometry import Camera, Sphere
from livlab.errors import InputError

theta = st.floats(0, math.pi / 2 - 1e-6)
azimuth = st.floats(-math.pi, math.pi)
coordinate = st.floats(-1, 1)


def apart(a, b):
    """Angle between two azimuths."""
    return abs((a - b + math.pi) % (2 * math.pi) - math.pi)


@given(theta, theta, azimuth, azimuth)
def test_half_angles_come_back(theta_h, theta_d, phi_d, phi_h):
    wi, wo = from_half_angles(theta_h, theta_d, phi_d, phi_h)
    assert np.linalg.norm(wi) == pytest.approx(1, abs=1e-12) and np.linalg.norm(wo) == pytest.approx(1, abs=1e-12)
    back = half_angles(wi, wo)
    assert back.theta_h == pytest.approx(theta_h, abs=1e-12)
    assert back.theta_d == pytest.approx(theta_d, abs=1e-12)
    # An azimuth is worth as much as the sine it goes with.
    assert apart(back.phi_h, phi_h) * math.sin(theta_h) * math.cos(theta_d) < 1e-12
    if theta_h > 1e-3 and theta_d < 1.5:
        assert apart(back.phi_d, phi_d) * math.sin(theta_d) < 1e-9


@given(theta, azimuth, theta, azimuth)
def test_directions_come_back(theta_i, phi_i, theta_o, phi_o):
    wi, wo = direction(theta_i, phi_i), direction(theta_o, phi_o)
    angles = half_angles(wi, wo)
    back = from_half_angles(angles.theta_h, angles.theta_d, angles.phi_d, angles.phi_h)
    assert back[0] == pytest.approx(wi, abs=1e-12) and back[1] == pytest.approx(wo, abs=1e-12)
    assert polar_angle(wi) == pytest.approx(theta_i, abs=1e-12)


@given(theta, azimuth, theta, azimuth, azimuth)
def test_what_swapping_mirroring_and_turning_do(theta_i, phi_i, theta_o, phi_o, turn):
    wi, wo = direction(theta_i, phi_i), direction(theta_o, phi_o)
    there, back = half_angles(wi, wo), half_angles(wo, wi)
    assert back.theta_h == pytest.approx(there.theta_h, abs=1e-12)
    assert back.theta_d == pytest.approx(there.theta_d, abs=1e-12)
    sure = math.sin(there.theta_d) * math.sin(there.theta_h) > 1e-4
    if sure:
        assert apart(back.phi_d, there.phi_d + math.pi) < 1e-7
        flip = np.array([1.0, -1.0, 1.0])
        assert apart(half_angles(wi * flip, wo * flip).phi_d, -there.phi_d) < 1e-7
        turned = half_angles(direction(theta_i, phi_i + turn), direction(theta_o, phi_o + turn))
        assert apart(turned.phi_d, there.phi_d) < 1e-7


@pytest.mark.parametrize("tiny", [1e-3, 1e-6, 1e-9])
def test_small_angles_keep_their_digits(tiny):
    """Against 50 digits, where an arc cosine in double precision would lose half of them or all."""
    mpmath.mp.dps = 50
    wi, wo = direction(0.7 + tiny, 0.2), direction(0.7 - tiny, 0.2 + tiny)
    a, b = ([mpmath.mpf(float(c)) for c in w] for w in (wi, wo))
    dot = sum(p * q for p, q in zip(a, b, strict=True))
    length = mpmath.sqrt(sum(p * p for p in a) * sum(q * q for q in b))
    assert float(half_angles(wi, wo).theta_d) == pytest.approx(float(mpmath.acos(dot / length) / 2), rel=1e-15 / tiny)
    assert half_angles(direction(tiny, 1.0), direction(tiny, 1.0)).theta_h == pytest.approx(tiny, rel=1e-12)


def test_closed_forms():
    # Mirror reflection: h is the normal. Retroreflection: h is the direction itself.
    mirror = half_angles(direction(0.6, 0.3), direction(0.6, 0.3 + np.pi))
    assert (mirror.theta_h, mirror.theta_d) == pytest.approx((0, 0.6), abs=1e-15)
    retro = half_angles(direction(0.6, 0.3), direction(0.6, 0.3))
    assert (retro.theta_h, retro.theta_d, retro.phi_h) == pytest.approx((0.6, 0, 0.3), abs=1e-15)
    # In the plane of incidence phi_d is 0 or pi, beside it a quarter turn.
    assert half_angles(direction(0.6, 0.0), direction(0.2, 0.0)).phi_d == pytest.approx(0, abs=1e-12)
    assert half_angles(direction(0.2, 0.0), direction(0.6, 0.0)).phi_d == pytest.approx(np.pi, abs=1e-12)
    beside = half_angles(direction(0.5, 0.7), direction(0.5, -0.7))
    assert beside.phi_d == pytest.approx(np.pi / 2, abs=1e-12) and beside.phi_h == pytest.approx(0, abs=1e-12)
    # cos theta_i = cos theta_h cos theta_d - sin theta_h sin theta_d cos phi_d
    wi, wo = from_half_angles(0.4, 0.5, 1.1)
    cross = math.sin(0.4) * math.sin(0.5) * math.cos(1.1)
    assert wi[2] == pytest.approx(math.cos(0.4) * math.cos(0.5) - cross, abs=1e-15)
    assert wo[2] == pytest.approx(math.cos(0.4) * math.cos(0.5) + cross, abs=1e-15)


@given(st.tuples(coordinate, coordinate, coordinate), st.tuples(coordinate, coordinate, coordinate))
def test_frames_are_right_handed_with_y_to_the_pole(normal, axis):
    if np.linalg.norm(normal) < 1e-3 or np.linalg.norm(axis) < 1e-3:
        return
    normal, axis = np.array(normal) / np.linalg.norm(normal), np.array(axis)
    frame = local_frames(normal, axis)
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1, abs=1e-12)
    assert frame[2] == pytest.approx(normal, abs=1e-15)
    pole = axis / np.linalg.norm(axis)
    if np.linalg.norm(np.cross(pole, normal)) > 1e-6:
        assert frame[0] @ pole == pytest.approx(0, abs=1e-9) and frame[1] @ pole >= 0


@settings(deadline=None)
@given(
    st.tuples(coordinate, coordinate, coordinate),
    st.floats(0, math.pi),
    st.lists(st.floats(-0.15, 0.15), min_size=2, max_size=2),
    st.floats(-0.01, 0.01),
    st.booleans(),
)
def test_a_ray_is_seen_where_it_came_from(axis, turn, radial, tangential, orthographic):
    import cv2

    if np.linalg.norm(axis) < 1e-2:
        return
    rotation = cv2.Rodrigues(np.array(axis) / np.linalg.norm(axis) * turn)[0]
    lens = [] if orthographic else [*radial, tangential, -tangential, 0.01]
    matrix = [[800.0, 3.0, 310.0], [0, 790.0, 235.0], [0, 0, 1]]
    camera = Camera(640, 480, matrix, rotation, [4.0, -7.0, 300.0], lens, orthographic)
    columns, rows = np.meshgrid(np.linspace(0, 639, 7), np.linspace(0, 479, 5))
    origins, directions = camera.rays(columns, rows)
    assert np.linalg.norm(directions, axis=-1) == pytest.approx(np.ones(columns.shape), abs=1e-12)
    seen = camera.project(origins + 123.0 * directions)
    assert np.max(np.abs(seen - np.stack([columns, rows], axis=-1))) < 1e-6


def test_a_lens_against_opencv():
    import cv2

    rotation = cv2.Rodrigues(np.array([0.2, -0.3, 0.1]))[0]
    lens = np.array([-0.2, 0.1, 1e-3, -2e-3, 0.05, 0.01, 0.02, -0.01])
    matrix = np.array([[800.0, 0, 310], [0, 790, 235], [0, 0, 1]])
    camera = Camera(640, 480, matrix, rotation, np.array([4.0, -7, 300]), lens)
    points = np.random.default_rng(0).uniform(-40, 40, (50, 3))
    expected, _ = cv2.projectPoints(points, rotation, np.array([4.0, -7, 300]), matrix, lens)
    assert camera.project(points) == pytest.approx(expected[:, 0], abs=1e-9)


def test_the_outline_is_where_rays_graze():
    camera = Camera(
        640, 480, np.array([[800.0, 0, 310], [0, 790, 235], [0, 0, 1]]), translation=np.array([30.0, 10, 300])
    )
    sphere = Sphere([1.0, 2.0, 3.0], 40.0)
    edge = sphere.outline(camera)
    middle = edge.mean(axis=0)
    for factor, inside in ((1 - 1e-6, True), (1 + 1e-6, False)):
        moved = middle + factor * (edge - middle)
        assert np.all(sphere.meet(*camera.rays(moved[:, 0], moved[:, 1])).hit == inside)


def test_points_met_lie_on_the_sphere_towards_the_eye():
    camera = Camera(
        640, 480, np.array([[800.0, 0, 310], [0, 790, 235], [0, 0, 1]]), translation=np.array([3.0, 1, 3e5])
    )
    sphere = Sphere([1.0, 2.0, 3.0], 4e4)
    origins, directions = camera.rays(*np.meshgrid(np.arange(220, 400, 9), np.arange(150, 320, 9)))
    hits = sphere.meet(origins, directions)
    on = hits.hit
    assert on.sum() > 100
    off = np.linalg.norm(hits.points_mm[on] - sphere.centre_mm, axis=-1) / 4e4 - 1
    assert np.max(np.abs(off)) < 1e-14
    assert np.all(np.sum(hits.normals[on] * directions[on], axis=-1) <= 0)


def test_directions_have_to_be_unit_vectors():
    for wrong in ([1.0, 0.0], [[0.0, 0.0, 1.1]], [[np.nan, 0, 1]], 3.0):
        with pytest.raises(InputError):
            unit_directions("wi", wrong)
    with pytest.raises(InputError, match=r"wi\[2\]"):
        unit_directions("wi", [[0, 0, 1], [0, 1, 0], [0, 0, 0]])
