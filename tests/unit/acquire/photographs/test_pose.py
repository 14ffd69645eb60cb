"""Sphere pose from the outline: truth is a rendered sphere whose cone is known."""

import numpy as np
import pytest
from synthetic_camera import Faults, blinn_phong, camera, lambert, render, ring, sphere_for

from livlab.acquire.photographs.cone import circle_of, fit_cone, pixels, rays
from livlab.acquire.photographs.pose import all_round, sphere_pose
from livlab.brdf.geometry import Camera, Light
from livlab.errors import InputError

LENS = (-0.2, 0.05, 0.001, -0.001, 0.0)


def true_circle(cam, sphere):
    c = cam.rotation @ sphere.centre_mm + cam.translation
    far = np.linalg.norm(c)
    return np.array(circle_of(cam, c / far, float(np.arcsin(sphere.radius_mm / far))))


@pytest.fixture(scope="module")
def scene():
    cam = camera(180, 160, distortion=LENS)
    sphere = sphere_for(cam, 50.0, (9.2, -6.3))
    return cam, sphere, render(cam, sphere, ring(8, 90) + ring(8, 40), lambert())


@pytest.mark.parametrize("orthographic", [False, True])
def test_rays_and_pixels_invert_each_other(orthographic):
    cam = camera(distortion=() if orthographic else LENS, orthographic=orthographic)
    uv = np.random.default_rng(1).uniform([0, 0], [179, 159], (50, 2))
    np.testing.assert_allclose(pixels(cam, rays(cam, uv)), uv, atol=1e-6)


def test_exact_points_give_the_exact_cone_off_the_axis():
    cam = camera(focal_px=200.0, distortion=LENS)
    axis = np.array([0.15, -0.1, 1.0]) / np.linalg.norm([0.15, -0.1, 1.0])
    from livlab.acquire.photographs.cone import cone_outline

    curve, _ = cone_outline(cam, axis, 0.2, 200)
    cone = fit_cone(curve, cam)
    np.testing.assert_allclose(cone.axis, axis, atol=1e-9)
    assert cone.half_angle == pytest.approx(0.2, abs=1e-9)


def test_a_third_of_outliers_does_not_move_the_cone():
    rng = np.random.default_rng(3)
    cam = camera()
    phi = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    uv = np.column_stack([90 + 50 * np.cos(phi), 75 + 50 * np.sin(phi)]) + rng.normal(0, 0.05, (300, 2))
    clean = fit_cone(uv, cam)
    uv[:100] += rng.uniform(-15, 15, (100, 2))
    cone = fit_cone(uv, cam)
    u, v, r = np.subtract(circle_of(cam, cone.axis, cone.half_angle), circle_of(cam, clean.axis, clean.half_angle))
    assert max(abs(u), abs(v), abs(r)) < 0.02
    assert cone.used[100:].mean() > 0.95


def test_the_covariance_is_the_scatter_over_repeats():
    cam = camera()
    phi = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    circle = np.column_stack([90 + 50 * np.cos(phi), 75 + 50 * np.sin(phi)])
    rng = np.random.default_rng(5)
    cones = [fit_cone(circle + rng.normal(0, 0.2, circle.shape), cam) for _ in range(80)]
    scatter = np.std([c.half_angle for c in cones], ddof=1)
    told = np.sqrt(np.mean([c.covariance[2, 2] for c in cones]))
    # 80 repeats know a standard deviation to 8 %.
    assert told == pytest.approx(scatter, rel=0.3)


def test_all_round_frame_gives_the_pose(scene):
    cam, sphere, images = scene
    pose = sphere_pose(all_round(images), cam, sphere.radius_mm)
    error = np.array(pose.circle_px) - true_circle(cam, sphere)
    assert np.hypot(*error[:2]) < 0.03
    assert abs(error[2]) < 0.06
    off = pose.sphere.centre_mm - sphere.centre_mm
    assert np.all(np.abs(off) < 3 * np.sqrt(np.diag(pose.covariance)[:3]))
    assert pose.support > 0.95
    assert pose.notes == ()


def test_silhouette_dark_before_bright(scene):
    cam, sphere, _ = scene
    c = sphere.centre_mm / np.linalg.norm(sphere.centre_mm)
    frame = render(cam, sphere, [Light(np.ones(1), direction=c)], lambert(), background=1.0)[0]
    pose = sphere_pose(frame, cam, sphere.radius_mm, kind="silhouette")
    assert np.abs(np.array(pose.circle_px) - true_circle(cam, sphere)).max() < 0.02


def test_a_single_light_says_its_bias_and_keeps_it(scene):
    cam, sphere, images = scene
    pose = sphere_pose(images[8], cam, sphere.radius_mm, kind="single")
    error = np.abs(np.array(pose.circle_px) - true_circle(cam, sphere))
    assert error.max() > 0.1  # the bias is there
    assert np.all(error < 2 * np.array(pose.circle_sd_px))
    assert "single light" in pose.notes[0]
    # The whole limb is dark under a light beside the camera, whatever the frame is said to be.
    front = render(cam, sphere, ring(1, 0), lambert())[0]
    dark = sphere_pose(front, cam, sphere.radius_mm)
    assert "limb is dark" in dark.notes[0]
    assert dark.systematic_px[1] > 0.3


def noisy(images):
    faults = Faults(gain=2e-4, read=2e-3, bits=8)
    return all_round(faults(image, k) for k, image in enumerate(images))


def test_noise_and_8_bits_leave_it(scene):
    cam, sphere, images = scene
    pose = sphere_pose(noisy(3 * images), cam, sphere.radius_mm)
    assert np.abs(np.array(pose.circle_px) - true_circle(cam, sphere)).max() < 0.06


def test_highlights_brighter_than_the_limb_are_not_taken_for_the_sphere(scene):
    cam, sphere, _ = scene
    pose = sphere_pose(noisy(render(cam, sphere, ring(8, 90) + ring(8, 40), blinn_phong())), cam, sphere.radius_mm)
    error = np.abs(np.array(pose.circle_px) - true_circle(cam, sphere))
    assert error.max() < 0.3  # highlights 5 px from the limb raise the level inside it, and the note says so
    assert np.all(error < 2 * np.array(pose.circle_sd_px))
    assert "limb is dark" in pose.notes[0]


def test_the_uncertain_radius_moves_the_centre_along_the_ray(scene):
    cam, sphere, images = scene
    frame = all_round(images)
    sure = sphere_pose(frame, cam, sphere.radius_mm)
    unsure = sphere_pose(frame, cam, sphere.radius_mm, radius_sd_mm=0.2)
    gained = np.sqrt(unsure.covariance[2, 2] - sure.covariance[2, 2])
    assert gained == pytest.approx(0.2 / sphere.radius_mm * sphere.centre_mm[2], rel=0.02)
    twice = sphere_pose(frame, cam, 2 * sphere.radius_mm)
    np.testing.assert_allclose(twice.sphere.centre_mm, 2 * sure.sphere.centre_mm, rtol=1e-6)


def test_world_frame_of_a_turned_camera(scene):
    cam, _, images = scene
    turn = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    moved = Camera(cam.width, cam.height, cam.matrix, turn, np.array([1.0, 2.0, 3.0]), cam.distortion)
    there = sphere_pose(all_round(images), cam, 20.0).sphere.centre_mm
    here = sphere_pose(all_round(images), moved, 20.0).sphere.centre_mm
    np.testing.assert_allclose(turn @ here + [1, 2, 3], there, atol=1e-9)


def test_orthographic_camera_reads_the_radius():
    rows, columns = np.mgrid[0:160, 0:180]
    fine = [
        np.hypot(columns + a - 80.3, rows + b - 70.6) < 50.2
        for a in np.linspace(-0.4375, 0.4375, 8)
        for b in np.linspace(-0.4375, 0.4375, 8)
    ]
    frame = np.mean(fine, axis=0)
    matrix = np.array([[4.0, 0, 89.5], [0, 4.0, 79.5], [0, 0, 1]])
    cam = Camera(180, 160, matrix, orthographic=True)
    pose = sphere_pose(frame, cam, kind="silhouette")
    np.testing.assert_allclose(pose.circle_px, (80.3, 70.6, 50.2), atol=0.02)
    assert pose.sphere.radius_mm == pytest.approx(50.2 / 4, abs=0.01)
    np.testing.assert_allclose(pose.sphere.centre_mm[:2], [(80.3 - 89.5) / 4, (70.6 - 79.5) / 4], atol=0.01)
    with pytest.raises(InputError, match=r"the picture shows 12\.5"):
        sphere_pose(frame, cam, 20.0, kind="silhouette")


def disc(u, v, a, b, *, shape=(160, 180)):
    rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
    return np.clip(0.5 + min(a, b) * (1 - np.hypot((columns - u) / a, (rows - v) / b)), 0, 1)


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (np.zeros((160, 180)), "no sphere"),
        (np.random.default_rng(0).normal(1, 0.1, (160, 180)), "no sphere"),
        (np.tile(np.linspace(0, 1, 180), (160, 1)), "no sphere"),
        (np.clip(disc(40, 80, 32, 32) + disc(130, 80, 35, 35), 0, 1), "two spheres"),
        (disc(90, 80, 60, 54), "ellipse"),
        (disc(90, 80, 62, 60), "ellipse"),
        (disc(30, 80, 50, 50), "cut by the frame"),
        (disc(90, 120, 50, 50), "cut by the frame"),
        (np.full((160, 180), np.nan), "no sphere"),
        (np.zeros((80, 180)), "must be the camera's 180x160"),
    ],
    ids=["black", "noise", "ramp", "two", "ellipse", "slight", "cut", "cut below", "nan", "size"],
)
def test_refused(frame, said):
    with pytest.raises(InputError, match=said):
        sphere_pose(frame, camera(), 20.0, kind="silhouette")


def test_a_square_is_no_sphere():
    frame = np.zeros((160, 180))
    frame[40:120, 50:130] = 1
    with pytest.raises(InputError, match=r"no sphere|ellipse"):
        sphere_pose(frame, camera(), 20.0, kind="silhouette")


def test_near_chooses_one_of_two():
    frame = np.clip(disc(40, 80, 32, 32) + disc(130, 80, 35, 35), 0, 1)
    pose = sphere_pose(frame, camera(), 20.0, kind="silhouette", near=(42, 78, 30))
    np.testing.assert_allclose(pose.circle_px, (40, 80, 32), atol=0.1)


def test_radius_is_asked_for():
    with pytest.raises(InputError, match="measure the sphere"):
        sphere_pose(disc(90, 80, 50, 50), camera())


def test_a_sphere_that_fills_an_orthographic_frame_is_found() -> None:
    camera = Camera(247, 247, np.array([[4.6, 0.0, 123.0], [0.0, 4.6, 123.0], [0.0, 0.0, 1.0]]), orthographic=True)
    v, u = np.mgrid[0:247, 0:247]
    dark = np.clip(np.hypot(u - 123.2, v - 122.9) - 115.0 + 0.5, 0.0, 1.0)
    found = sphere_pose(dark, camera, 25.0, kind="silhouette")
    assert found.circle_px == pytest.approx((123.2, 122.9, 115.0), abs=0.05)
    squeezed = np.clip(np.hypot(u - 123.2, (v - 122.9) / 0.96) - 115.0 + 0.5, 0.0, 1.0)
    with pytest.raises(InputError, match="ellipse"):
        sphere_pose(squeezed, camera, 25.0, kind="silhouette")
