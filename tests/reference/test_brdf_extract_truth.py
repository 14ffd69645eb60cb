"""How well samples at pixel centres, and footprints, give back a BRDF that is known: the errors that resolution makes.

The images are made in the world frame from dot products alone, each pixel the mean over 6 by 6 Gauss points.
"""

import numpy as np
import pytest
import xarray as xr

from livlab.brdf.footprint import footprints
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.sphere import extract

RADIUS, DISTANCE = 20.0, 200.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


def diffuse(cos_i, cos_o, cos_h):
    return np.full_like(cos_i, 0.5 / np.pi)


def ggx(alpha):
    """Isotropic GGX with Smith's shadowing, no Fresnel term (Walter et al. 2007, eq. 33, 34)."""

    def value(cos_i, cos_o, cos_h):
        spread = alpha**2 / (np.pi * (1 + (alpha**2 - 1) * cos_h**2) ** 2)
        shadow = [2 / (1 + np.sqrt(1 + alpha**2 * (1 / c**2 - 1))) for c in (cos_i, cos_o)]
        return spread * shadow[0] * shadow[1] / (4 * cos_i * cos_o)

    return value


def scene(radius_px):
    side = 2 * int(radius_px * 1.05) + 2
    focal = radius_px * np.sqrt((DISTANCE / RADIUS) ** 2 - 1)
    matrix = [[focal, 0, (side - 1) / 2 + 0.21], [0, focal, (side - 1) / 2 - 0.13], [0, 0, 1]]
    light = Light(np.ones(1) * 4e4, position_mm=[DISTANCE * np.sin(0.8), 15.0, -DISTANCE * np.cos(0.8)])
    return Camera(side, side, matrix, translation=[0, 0, DISTANCE]), light, Sphere([0, 0, 0], RADIUS)


def picture(f, camera, light):
    """Mean radiance of each pixel, from x = c + t d with the eye at the origin of the rays."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    eye = np.array([0.0, 0.0, -DISTANCE])
    total = np.zeros(columns.shape)
    for du, wu in zip(NODES / 2, WEIGHTS / 2, strict=True):
        for dv, wv in zip(NODES / 2, WEIGHTS / 2, strict=True):
            x = (columns + du - camera.matrix[0, 2]) / camera.matrix[0, 0]
            y = (rows + dv - camera.matrix[1, 2]) / camera.matrix[1, 1]
            d = np.stack([x, y, np.ones_like(x)], axis=-1) / np.sqrt(x**2 + y**2 + 1)[..., None]
            b = d @ eye
            root = b**2 - (eye @ eye - RADIUS**2)
            point = eye + (-b - np.sqrt(np.maximum(root, 0)))[..., None] * d
            normal = point / RADIUS
            offset = light.position_mm - point
            far = np.linalg.norm(offset, axis=-1)
            wi = offset / far[..., None]
            half = wi - d
            half /= np.linalg.norm(half, axis=-1, keepdims=True)
            cos_i, cos_o, cos_h = (np.sum(w * normal, axis=-1) for w in (wi, -d, half))
            lit = (root > 0) & (cos_i > 0) & (cos_o > 0)
            ci, co = np.where(lit, cos_i, 1.0), np.where(lit, cos_o, 1.0)
            total += wu * wv * np.where(lit, f(ci, co, cos_h) * light.intensity[0] * ci / far**2, 0.0)
    return xr.DataArray(total[None, :, :, None], dims=("light", "row", "column", "channel"))


def local(f, wi, wo):
    half = wi + wo
    return f(wi[..., 2], wo[..., 2], half[..., 2] / np.linalg.norm(half, axis=-1))


def errors(f, radius_px):
    """Relative errors of the samples against f at pixel centres and against f over footprints, and cos θ_h."""
    camera, light, sphere = scene(radius_px)
    samples = extract(picture(f, camera, light), camera, [light], sphere)
    value, wi, wo = samples["value"].values[:, 0], samples["wi"].values, samples["wo"].values
    over = np.empty_like(value)
    for batch in footprints(samples, 3, rule="gauss"):
        over[batch.index] = np.sum(batch.weight * local(f, batch.wi, batch.wo), axis=1)
    return value / local(f, wi, wo) - 1, value / over - 1, samples["theta_h"].values


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


def test_diffuse_at_115_pixels_is_within_a_tenth_of_a_percent():
    centre, over, _ = errors(diffuse, 115)
    assert rms(centre) < 2e-4
    assert rms(over) < 1e-7


def test_ggx_at_115_pixels_is_within_a_fifth_of_a_percent():
    centre, over, _ = errors(ggx(0.1), 115)
    assert rms(centre) < 1e-3
    assert rms(over) < 1e-6


@pytest.mark.parametrize("f", [diffuse, ggx(0.1)])
def test_the_error_of_pixel_centres_falls_with_resolution(f):
    coarse, fine = rms(errors(f, 29)[0]), rms(errors(f, 58)[0])
    assert coarse < 1.2e-2 and 2 < coarse / fine < 5


@pytest.mark.parametrize(("alpha", "radius_px"), [(0.1, 58), (0.1, 115), (0.06, 115)])
def test_the_lobe_looks_lower_than_it_is_by_a_known_share(alpha, radius_px):
    """Near its peak GGX falls as 1 - 2 (θ_h/α)², and a pixel spreads the normal by 1/R across and 1/(R cos θ_o) along.

    The mean of θ_h² over such a square is (1 + 1/cos² θ_o) / (12 R²).
    """
    centre, over, theta_h = errors(ggx(alpha), radius_px)
    core = theta_h < 0.25 * alpha
    expected = -(1 + 1 / np.cos(0.4) ** 2) / 6 / (radius_px * alpha) ** 2
    assert core.sum() >= 5
    assert float(centre[core].mean()) == pytest.approx(expected, rel=0.15)
    assert abs(float(over[core].mean())) < 0.001 * abs(expected)
