"""Extraction against images made pixel by pixel in plain Python: another road to the same geometry."""

import math

import numpy as np
import pytest
import xarray as xr

from livlab.brdf.footprint import footprint
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.sphere import extract

WIDTH, HEIGHT = 40, 36
FOCAL_X, FOCAL_Y, MIDDLE_X, MIDDLE_Y = 150.0, 152.0, 19.3, 18.1
LENS = (-0.21, 0.08, 0.002, -0.003, 0.05)
TURN = 0.35  # the camera turns about the world's y axis
SHIFT = (-1.0, -2.0, 110.0)
CENTRE, RADIUS = (1.0, 2.0, 4.0), 10.0


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a, b):
    return tuple(p - q for p, q in zip(a, b, strict=True))


def unit(a):
    length = math.sqrt(dot(a, a))
    return tuple(p / length for p in a)


def to_world(v):
    """Rotation of the camera undone: rows of R are the camera's axes."""
    c, s = math.cos(TURN), math.sin(TURN)
    return (c * v[0] - s * v[2], v[1], s * v[0] + c * v[2])


def bend(x, y, lens):
    """OpenCV's lens, written out."""
    k1, k2, p1, p2, k3 = lens
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def straighten(x, y, lens):
    """The lens undone by going back and forth until nothing moves."""
    a, b = x, y
    for _ in range(200):
        c, d = bend(a, b, lens)
        a, b = a + (x - c), b + (y - d)
    return a, b


def look(u, v, lens):
    """Point, normal and direction to the eye seen at pixel (u, v), or None."""
    x, y = straighten((u - MIDDLE_X) / FOCAL_X, (v - MIDDLE_Y) / FOCAL_Y, lens)
    direction = unit(to_world((x, y, 1.0)))
    eye = to_world(tuple(-p for p in SHIFT))
    to_eye = minus(eye, CENTRE)
    half = dot(direction, to_eye)
    inside = half * half - (dot(to_eye, to_eye) - RADIUS * RADIUS)
    if inside < 0:
        return None
    t = -half - math.sqrt(inside)
    point = tuple(e + t * d for e, d in zip(eye, direction, strict=True))
    return point, unit(minus(point, CENTRE)), tuple(-d for d in direction)


def lambert(normal, light, eye):
    return 0.4 / math.pi


def ggx(normal, light, eye, alpha=0.15, weight=0.6):
    """Isotropic GGX with Smith's shadowing (Walter et al. 2007, eq. 33, 34) on a diffuse base."""
    half = unit(tuple(a + b for a, b in zip(light, eye, strict=True)))
    c, ci, co = dot(half, normal), dot(light, normal), dot(eye, normal)
    spread = alpha**2 / (math.pi * (1 + (alpha**2 - 1) * c * c) ** 2)

    def shadow(cosine):
        return 2 / (1 + math.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)))

    return weight * spread * shadow(ci) * shadow(co) / (4 * ci * co) + 0.2 / math.pi


LIGHTS = (
    {"position_mm": (60.0, -20.0, -70.0), "intensity": (5e3, 7e3)},
    {"position_mm": (-30.0, 40.0, -25.0), "intensity": (4e3, 1e3)},
    {"direction": unit((0.3, 0.2, -1.0)), "intensity": (2.0, 3.0)},
)


def radiance(light, f, u, v, lens):
    seen = look(u, v, lens)
    if seen is None:
        return (0.0, 0.0)
    point, normal, eye = seen
    if "direction" in light:
        towards, fall = light["direction"], 1.0
    else:
        offset = minus(light["position_mm"], point)
        towards, fall = unit(offset), 1 / dot(offset, offset)
    cosine = dot(towards, normal)
    if cosine <= 0 or dot(eye, normal) <= 0:
        return (0.0, 0.0)
    return tuple(f(normal, towards, eye) * i * fall * cosine for i in light["intensity"])


def images(f, points, lens=LENS, lights=LIGHTS):
    """Mean radiance (light, row, column, channel) over points inside each pixel."""
    out = np.zeros((len(lights), HEIGHT, WIDTH, 2))
    for k, light in enumerate(lights):
        for row in range(HEIGHT):
            for column in range(WIDTH):
                for du in points:
                    for dv in points:
                        out[k, row, column] += radiance(light, f, column + du, row + dv, lens)
    return xr.DataArray(out / len(points) ** 2, dims=("light", "row", "column", "channel"))


def rig(lens=LENS):
    c, s = math.cos(TURN), math.sin(TURN)
    camera = Camera(
        WIDTH,
        HEIGHT,
        np.array([[FOCAL_X, 0, MIDDLE_X], [0, FOCAL_Y, MIDDLE_Y], [0, 0, 1]]),
        np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        np.array(SHIFT),
        np.array(lens),
    )
    return camera, [Light(**light) for light in LIGHTS], Sphere(CENTRE, RADIUS)


@pytest.mark.parametrize("f", [lambert, ggx])
def test_values_at_pixel_centres_are_those_of_plain_python(f):
    exposure, white = np.array([0.5, 2.0, 1.0]), np.array([3.0, 0.25])
    pictures = images(f, (0.0,)) * exposure[:, None, None, None] * white
    samples = extract(pictures, *rig(), exposure=exposure, white=white)
    assert samples.sizes["sample"] > 800 and set(samples["light"].values) == {0, 1, 2}
    worst = 0.0
    for j in range(0, samples.sizes["sample"], 3):
        one = samples.isel(sample=j)
        point, normal, eye = look(float(one["column"]), float(one["row"]), LENS)
        light = LIGHTS[int(one["light"])]
        towards = light["direction"] if "direction" in light else unit(minus(light["position_mm"], point))
        expected = f(normal, towards, eye)
        worst = max(worst, *(abs(float(v) / expected - 1) for v in one["value"]))
        assert float(one["theta_i"]) == pytest.approx(math.acos(dot(normal, towards)), abs=1e-9)
        assert float(one["theta_o"]) == pytest.approx(math.acos(dot(normal, eye)), abs=1e-9)
        half = unit(tuple(a + b for a, b in zip(towards, eye, strict=True)))
        assert float(one["theta_h"]) == pytest.approx(math.acos(min(dot(normal, half), 1)), abs=1e-7)
        assert float(one["theta_d"]) == pytest.approx(math.acos(min(dot(towards, half), 1)), abs=1e-7)
        assert float(one["wi"] @ one["wo"]) == pytest.approx(dot(towards, eye), abs=1e-12)
    assert worst < 1e-10


def test_limits_drop_what_they_say():
    samples = extract(images(lambert, (0.0,)), *rig())
    kept = set(zip(samples["light"].values, samples["row"].values, samples["column"].values, strict=True))
    limit = math.cos(math.radians(80))
    # The outline's radius in pixels, from the cone that touches the sphere.
    eye = minus(to_world(tuple(-p for p in SHIFT)), CENTRE)
    radius = samples.attrs["radius_px"]
    assert radius == pytest.approx(FOCAL_X * RADIUS / math.sqrt(dot(eye, eye) - RADIUS**2), rel=0.03)
    expected = set()
    for k, light in enumerate(LIGHTS):
        for row in range(HEIGHT):
            for column in range(WIDTH):
                seen = look(column, row, LENS)
                if seen is None:
                    continue
                point, normal, to_eye = seen
                towards = light["direction"] if "direction" in light else unit(minus(light["position_mm"], point))
                co, ci = dot(normal, to_eye), dot(normal, towards)
                if ci >= limit and co >= limit and (1 - math.sqrt(1 - co * co)) * radius >= 0.8:
                    expected.add((k, row, column))
    assert kept == expected


def test_footprint_averages_what_the_pixel_averages():
    points = [(k + 0.5) / 3 - 0.5 for k in range(3)]
    samples = extract(images(ggx, points), *rig())
    inside = footprint(samples, 3)
    up = (0.0, 0.0, 1.0)

    def model(wi, wo):
        return np.array(
            [ggx(up, tuple(a), tuple(b)) for a, b in zip(wi.reshape(-1, 3), wo.reshape(-1, 3), strict=True)]
        )

    mean = np.sum(inside.weight * model(inside.wi, inside.wo).reshape(inside.weight.shape), axis=1)
    assert np.max(np.abs(mean / samples["value"].values[:, 0] - 1)) < 1e-10
    # And it matters: at pixel centres the same model is off by far more.
    centre = footprint(samples, 1)
    assert np.max(np.abs(model(centre.wi, centre.wo) / samples["value"].values[:, 0] - 1)) > 1e-2


def test_few_gauss_points_do_what_many_midpoints_do():
    samples = extract(images(lambert, (0.0,)), *rig())
    some = np.arange(0, samples.sizes["sample"], 20)

    def weights(n, rule):
        return footprint(samples, n, rule=rule, index=some).weight.sum(axis=1)

    fine = weights(64, "midpoint")
    errors = {n: np.max(np.abs(weights(n, "midpoint") - fine)) for n in (4, 8)}
    assert errors[4] / errors[8] == pytest.approx(4, rel=0.1)  # second order
    assert np.max(np.abs(weights(3, "gauss") - fine)) < errors[8]


def test_solid_angle_and_area_of_pixels():
    camera, lights, sphere = rig(lens=(0.0,) * 5)
    samples = extract(images(lambert, (0.0,), lens=(0.0,) * 5), camera, lights, sphere)
    for j in range(0, samples.sizes["sample"], 97):
        one = samples.isel(sample=j)
        x, y = (float(one["column"]) - MIDDLE_X) / FOCAL_X, (float(one["row"]) - MIDDLE_Y) / FOCAL_Y
        solid = (1 + x * x + y * y) ** -1.5 / (FOCAL_X * FOCAL_Y)
        assert float(one["pixel_solid_angle"]) == pytest.approx(solid, rel=2e-5)
        point, normal, eye = look(float(one["column"]), float(one["row"]), (0.0,) * 5)
        origin = to_world(tuple(-p for p in SHIFT))
        distance2 = dot(minus(origin, point), minus(origin, point))
        assert float(one["area"]) == pytest.approx(solid * distance2 / dot(normal, eye), rel=2e-5)
