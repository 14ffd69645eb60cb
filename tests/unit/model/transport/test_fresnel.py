"""Fresnel: limits, totals, polarisation, near match; and incoherent plates."""

import math

import mpmath
import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.transport.fresnel import (
    diffuse_fresnel,
    fresnel,
    fresnel_amplitudes,
    fresnel_polarised,
    incoherent_stack,
    refracted_cosine,
)


def literal(n1: float, n2: float, mu: float) -> tuple[float, float]:
    """The textbook's formulas in the two cosines, with 60 digits."""
    with mpmath.workdps(60):
        a, b, c1 = mpmath.mpf(n1), mpmath.mpf(n2), mpmath.mpf(mu)
        c2 = mpmath.sqrt(1 - (a / b) ** 2 * (1 - c1**2))
        r_s = (a * c1 - b * c2) / (a * c1 + b * c2)
        r_p = (b * c1 - a * c2) / (b * c1 + a * c2)
        return float(abs(r_s) ** 2), float(abs(r_p) ** 2)


@pytest.mark.parametrize("mu", [1.0, 0.9, 0.5, 0.1, 1e-3, 1e-8])
@pytest.mark.parametrize("n", [(1.0, 1.5), (1.5, 1.0), (1.36, 1.38), (1.0, 1 + 1e-7), (1 + 1e-12, 1.0), (1.4, 0.7)])
def test_against_sixty_digits(n, mu):
    r_s, r_p = fresnel_polarised(*n, mu)
    want = literal(*n, mu)
    assert float(r_s) == pytest.approx(want[0], rel=2e-12, abs=1e-300)
    assert float(r_p) == pytest.approx(want[1], rel=2e-12, abs=1e-30)


def test_limits():
    assert float(fresnel(1.0, 1.5, 1.0)) == pytest.approx(0.04, rel=1e-15)
    assert float(fresnel(1.0, 1.5, 0.0)) == 1.0
    assert float(fresnel(1.5, 1.0, 0.0)) == 1.0
    assert float(fresnel(1.4, 1.4, 0.0)) == 0.0
    assert float(fresnel(1.4, 1.4, 0.3)) == 0.0
    critical = math.sqrt(1 - 1 / 1.5**2)
    assert float(fresnel(1.5, 1.0, critical * (1 - 1e-15))) == 1.0
    assert float(fresnel(1.5, 1.0, critical * (1 + 1e-4))) < 0.95
    brewster = 1 / math.hypot(1.0, 1.5)
    assert float(fresnel_polarised(1.0, 1.5, brewster)[1]) < 1e-30


def test_amplitudes_beyond_the_critical_angle_have_modulus_one_and_the_known_phase():
    n, mu = 1.5, 0.4
    r_s, r_p = fresnel_amplitudes(n, 1.0, mu)
    assert abs(complex(r_s)) == pytest.approx(1, abs=1e-14)
    assert abs(complex(r_p)) == pytest.approx(1, abs=1e-14)
    # Born & Wolf 1999, section 1.5.4: tan(δ/2) = √(sin²θ − n²)/cosθ and /(n² cosθ), n = n₂/n₁.
    root = math.sqrt(1 - mu**2 - 1 / n**2)
    assert abs(math.tan(np.angle(complex(r_s)) / 2)) == pytest.approx(root / mu, rel=1e-12)
    assert abs(math.tan(np.angle(complex(r_p)) / 2)) == pytest.approx(root / mu * n**2, rel=1e-12)


def test_signs_at_normal_incidence():
    r_s, r_p = fresnel_amplitudes(1.0, 1.5, 1.0)
    assert complex(r_s) == pytest.approx(-0.2)
    assert complex(r_p) == pytest.approx(0.2)


def test_broadcast_and_snell():
    mu = np.linspace(0, 1, 7)
    assert fresnel(np.array([[1.0], [1.3]]), 1.5, mu).shape == (2, 7)
    inside = refracted_cosine(1.0, 1.5, mu)
    np.testing.assert_allclose(1.5**2 * (1 - inside**2), 1 - mu**2, atol=1e-15)
    # The same light seen from the other side.
    np.testing.assert_allclose(fresnel(1.5, 1.0, inside[1:]), fresnel(1.0, 1.5, mu[1:]), rtol=1e-11)


def test_rounding_never_makes_a_cosine_above_one():
    rng = np.random.default_rng(1)
    n = rng.uniform(0.8, 2.0, (2, 20_000))
    assert refracted_cosine(n[0], n[1], 1.0).max() == 1.0


def test_plates():
    r = 0.04
    assert incoherent_stack([1, 1.5, 1])[0] == pytest.approx(2 * r / (1 + r), rel=1e-14)
    # m plates of the same glass: R = 2mr/(1 + (2m − 1) r) (Stokes 1862).
    reflectance, transmittance = incoherent_stack([1, 1.5, 1, 1.5, 1, 1.5, 1])
    assert reflectance == pytest.approx(6 * r / (1 + 5 * r), rel=1e-14)
    assert reflectance + transmittance == pytest.approx(1, abs=1e-14)
    depth = 0.7
    passed = math.exp(-depth)
    reflectance, transmittance = incoherent_stack([1, 1.5, 1], 1.0, [depth])
    assert transmittance == pytest.approx((1 - r) ** 2 * passed / (1 - (r * passed) ** 2), rel=1e-14)
    assert reflectance == pytest.approx(r + (1 - r) ** 2 * r * passed**2 / (1 - (r * passed) ** 2), rel=1e-14)
    assert incoherent_stack([1, 1.5, 1], 1.0, [math.inf]) == (pytest.approx(r), 0.0)
    assert incoherent_stack([1, 1, 1], 0.3) == (0.0, 1.0)


def test_plates_by_polarisation_and_total_reflection():
    rs, rp = fresnel_polarised(1.0, 1.5, 0.4)
    assert incoherent_stack([1, 1.5, 1], 0.4, polarisation="s")[0] == pytest.approx(2 * rs / (1 + rs))
    assert incoherent_stack([1, 1.5, 1], 0.4, polarisation="p")[0] == pytest.approx(2 * rp / (1 + rp))
    # Beyond the critical angle of a rare layer nothing passes, whatever lies below.
    assert incoherent_stack([1.5, 1.0, 1.5], 0.3) == (1.0, 0.0)
    r, t = incoherent_stack([1.4, 1.5, 1.0, 1.5], 0.3)
    assert (r, t) == (pytest.approx(1.0), 0.0)


@pytest.mark.parametrize("n", [1.05, 1.33, 1.5, 2.4])
def test_diffuse_light_against_the_closed_form(n):
    """Duntley 1942 (after Walsh) for light from the rarer side, and étendue for the other."""
    want = (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * math.log((n - 1) / (n + 1))
        - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * math.log(n)
    )
    assert diffuse_fresnel(1.0, n) == pytest.approx(want, abs=1e-10)
    assert n**2 * (1 - diffuse_fresnel(n, 1.0)) == pytest.approx(1 - want, abs=1e-10)


def test_diffuse_light_at_a_match():
    assert diffuse_fresnel(1.4, 1.4) == 0.0
    # A near match returns what is totally reflected, 1 − (n₂/n₁)², and little more.
    assert 2e-6 < diffuse_fresnel(1.0 + 1e-6, 1.0) < 4e-6


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: fresnel(0.0, 1.5, 1.0), "n_from"),
        (lambda: fresnel(1.0, math.nan, 1.0), "n_to"),
        (lambda: fresnel(1.0, 1.5, 1.1), "mu"),
        (lambda: fresnel(1.0, 1.5, math.nan), "mu"),
        (lambda: incoherent_stack([1.0]), "optical_depth"),
        (lambda: incoherent_stack([1.0, 1.5, 1.0], 1.0, [-1.0]), "optical_depth"),
        (lambda: incoherent_stack([1.0, 1.5], 0.0), "mu0"),
    ],
)
def test_bad_input(call, field):
    with pytest.raises(InputError, match=field):
        call()
