"""Lights from mirror balls: the ball is rendered, so that the truth is known."""

import numpy as np
import pytest
from synthetic_camera import camera, sphere_for, view_rays

from livlab.acquire.photographs.lights import distant_direction, lambert_intensities, mirror_highlight, near_position
from livlab.acquire.photographs.pose import SpherePose
from livlab.brdf.geometry import Sphere
from livlab.errors import InputError

HALF = np.deg2rad(2.0)


def pose_of(cam, ball, sd_mm=0.0):
    radius_px = cam.matrix[0, 0] * ball.radius_mm / np.linalg.norm(ball.centre_mm)
    covariance = np.diag([sd_mm**2, sd_mm**2, 0.0, 0.0])
    outline = ball.outline(cam)
    return SpherePose(
        ball,
        covariance,
        (*outline.mean(axis=0), radius_px),
        (0, 0, 0),
        (0, 0),
        0.0,
        1.0,
        outline,
        outline,
        "silhouette",
    )


def mirror(cam, ball, light, *, half=HALF, sub=5, ground=0.01, peak=20.0):
    """A mirror ball under a disc of light: a direction (unit), or a position with the disc's radius half · distance."""
    low, high = np.floor(ball.outline(cam).min(axis=0)).astype(int), np.ceil(ball.outline(cam).max(axis=0)).astype(int)
    columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1.0), np.arange(low[1], high[1] + 1.0))
    image = np.zeros((cam.height, cam.width))
    for i in range(sub):
        for j in range(sub):
            uv = np.stack([columns + (i + 0.5) / sub - 0.5, rows + (j + 0.5) / sub - 0.5], axis=-1)
            d = view_rays(cam, uv)
            hits = ball.meet(np.broadcast_to(cam.centre_mm, d.shape), d)
            out = d - 2 * np.sum(d * hits.normals, axis=-1, keepdims=True) * hits.normals
            to = light - hits.points_mm if np.linalg.norm(light) > 2 else np.broadcast_to(light, d.shape)
            shines = hits.hit & (np.sum(out * to, axis=-1) > np.cos(half) * np.linalg.norm(to, axis=-1))
            shown = np.where(shines, peak, np.where(hits.hit, ground, 0.0))
            image[low[1] : high[1] + 1, low[0] : high[0] + 1] += shown / sub**2
    return image


@pytest.fixture(scope="module")
def rig():
    cam = camera(260, 240, focal_px=1100.0, distortion=(-0.1, 0.02, 0, 0, 0))
    return cam, sphere_for(cam, 100.0, (6.0, -4.0))


def directions(count, within_deg=70.0, seed=2):
    rng = np.random.default_rng(seed)
    cos = rng.uniform(np.cos(np.deg2rad(within_deg)), 1, count)
    phi = rng.uniform(0, 2 * np.pi, count)
    sin = np.sqrt(1 - cos**2)
    return np.column_stack([sin * np.cos(phi), sin * np.sin(phi), -cos])


def angle_deg(a, b):
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def test_directions_to_a_tenth_of_a_degree(rig):
    cam, ball = rig
    off, z = [], []
    for light in directions(4):
        found = mirror_highlight(mirror(cam, ball, light), cam, pose_of(cam, ball), saturation=1e9)
        off.append(angle_deg(found.direction, light))
        z.append(np.deg2rad(off[-1]) / found.sd_rad)
    assert max(off) < 0.1
    assert max(z) < 3


def test_clipped_highlights_cost_little_and_are_told(rig):
    cam, ball = rig
    light = directions(1)[0]
    image = np.clip(mirror(cam, ball, light), 0, 1)
    found = mirror_highlight(image, cam, pose_of(cam, ball))
    off = angle_deg(found.direction, light)
    assert off < 0.4  # a third of a pixel: clipping leaves whole pixels only
    assert np.deg2rad(off) < 3 * found.sd_rad
    assert found.saturated > 0.5
    assert "clipped" in found.notes[0]


def test_the_source_s_solid_angle_is_bounded(rig):
    cam, ball = rig
    light = directions(1)[0]
    true = 2 * np.pi * (1 - np.cos(HALF))
    found = mirror_highlight(mirror(cam, ball, light), cam, pose_of(cam, ball), saturation=1e9)
    assert found.solid_angle_sr == pytest.approx(true, rel=0.25)


def test_the_pose_s_uncertainty_reaches_the_direction(rig):
    cam, ball = rig
    light = directions(1)[0]
    image = mirror(cam, ball, light)
    sd = 0.1
    unsure = mirror_highlight(image, cam, pose_of(cam, ball, sd), saturation=1e9)
    sure = mirror_highlight(image, cam, pose_of(cam, ball), saturation=1e9)
    told = np.sqrt(np.trace(unsure.covariance - sure.covariance))
    shifted = [Sphere(ball.centre_mm + sd * axis, ball.radius_mm) for axis in np.eye(3)[:2]]
    moved = [mirror_highlight(image, cam, pose_of(cam, b), saturation=1e9).direction - sure.direction for b in shifted]
    assert told == pytest.approx(np.sqrt(sum(m @ m for m in moved)), rel=0.05)


def test_near_light_from_two_balls():
    cam = camera(420, 240, focal_px=1100.0)
    balls = [sphere_for(cam, 80.0, (-110.0, 0.0)), sphere_for(cam, 80.0, (100.0, 10.0))]
    light = balls[0].centre_mm + np.array([60.0, -120.0, -160.0])
    seen = [
        mirror_highlight(mirror(cam, b, light, half=np.deg2rad(1.5)), cam, pose_of(cam, b), saturation=1e9)
        for b in balls
    ]
    found = near_position(seen)
    assert np.linalg.norm(found.position_mm - light) < 0.02 * found.distance_mm
    z = np.linalg.inv(found.covariance + 1e-9 * np.eye(3))
    off = found.position_mm - light
    assert off @ z @ off < 16  # chi-squared of 3, at 0.1 %
    assert found.miss_mm < 2.0


def test_a_distant_light_has_no_position():
    cam = camera(420, 240, focal_px=1100.0)
    balls = [sphere_for(cam, 80.0, (-110.0, 0.0)), sphere_for(cam, 80.0, (100.0, 10.0))]
    light = directions(1)[0]
    seen = [mirror_highlight(mirror(cam, b, light), cam, pose_of(cam, b), saturation=1e9) for b in balls]
    with pytest.raises(InputError, match="parallel"):
        near_position(seen)
    mean, covariance = distant_direction(seen)
    assert angle_deg(mean, light) < 0.1
    assert np.trace(covariance) < min(np.trace(h.covariance) for h in seen)
    assert abs(mean @ covariance @ mean) < 1e-12


def test_one_ball_gives_no_position(rig):
    cam, ball = rig
    one = mirror_highlight(mirror(cam, ball, directions(1)[0]), cam, pose_of(cam, ball), saturation=1e9)
    with pytest.raises(InputError, match="two balls"):
        near_position([one])
    with pytest.raises(InputError, match="one ball"):
        distant_direction([])


def test_no_highlight_and_two_highlights_are_refused(rig):
    cam, ball = rig
    pose = pose_of(cam, ball)
    with pytest.raises(InputError, match="no highlight"):
        mirror_highlight(np.full((cam.height, cam.width), 0.3), cam, pose)
    a, b = directions(2, seed=5)
    with pytest.raises(InputError, match="second highlight"):
        mirror_highlight(mirror(cam, ball, a) + mirror(cam, ball, b), cam, pose)


def test_grazing_light_is_refused(rig):
    cam, ball = rig
    behind = np.array([0.12, 0.0, 0.99])
    with pytest.raises(InputError, match=r"limb|no highlight"):
        mirror_highlight(mirror(cam, ball, behind / np.linalg.norm(behind)), cam, pose_of(cam, ball))


def test_pictures_of_another_size_are_refused(rig):
    cam, ball = rig
    with pytest.raises(InputError, match="must be 240 x 260"):
        mirror_highlight(np.zeros((10, 10)), cam, pose_of(cam, ball))


def test_intensities_from_a_matte_sphere():
    rng = np.random.default_rng(4)
    true = np.array([1.2, 0.8, 1.0])
    cosines = rng.uniform(0.05, 1, (3, 500))
    values = true[:, None] * cosines * 0.4 * (1 + rng.normal(0, 0.02, cosines.shape))
    values[0, 3] = np.nan
    found, error = lambert_intensities(values, cosines)
    assert np.all(np.abs(found[:, 0] - true / true.mean()) < 4 * error[:, 0])
    assert np.all(error < 0.005)
