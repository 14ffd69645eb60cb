"""Geometric attenuation against quadrature, high-precision arithmetic and its limits."""

import math

import mpmath
import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.particles.spheroid import attenuation, penalised_rate, surface_term


def term_in_60_digits(a: float, b: float) -> float:
    with mpmath.workdps(60):
        c = mpmath.sqrt(1 - mpmath.mpf(a) ** 2 / mpmath.mpf(b) ** 2)
        factor = mpmath.mpf(1) if c == 0 else mpmath.asin(c) / c
        return float(mpmath.re(mpmath.mpf(a) / mpmath.mpf(b) + factor))


@pytest.mark.parametrize(
    "ratio", [1e-8, 1e-3, 0.3, 2 / 3, 0.999, 1 - 1e-9, 1 - 1e-15, 1.0, 1 + 1e-15, 1 + 1e-9, 1.5, 1e3]
)
def test_shape_term_agrees_with_60_digits_prolate_spherical_and_oblate(ratio):
    assert surface_term(ratio * 30.0, 30.0) == pytest.approx(term_in_60_digits(ratio * 30.0, 30.0), rel=4e-16)


def test_the_thesis_prints_half_of_what_semi_axes_give():
    assert attenuation(0.020, 0.030, 0.8) * 10 == pytest.approx(269.26, abs=0.01)
    assert attenuation(0.010, 0.015, 0.8) * 10 == pytest.approx(538.52, abs=0.01)


@pytest.mark.parametrize(("a", "b"), [(0.010, 0.015), (0.012, 0.012), (0.015, 0.004)])
def test_attenuation_is_surface_over_four_volumes(a, b):
    t, w = np.polynomial.legendre.leggauss(100)
    t, w = 0.25 * math.pi * (t + 1), 0.25 * math.pi * w  # latitude 0 … π/2, both halves counted below
    surface = 2 * (w * 2 * math.pi * a * np.cos(t) * np.hypot(a * np.sin(t), b * np.cos(t))).sum()
    volume = 4 / 3 * math.pi * a * a * b
    assert attenuation(a, b, 0.8) == pytest.approx(0.8 * surface / (4 * volume), rel=1e-12)


def test_sphere_is_three_quarters_of_fraction_over_radius():
    assert attenuation(0.01, 0.01, 0.5) == pytest.approx(0.75 * 0.5 / 0.01, rel=1e-15)


def test_penalised_rate_falls_as_attenuation_grows_and_zero_never_interacts():
    rate = penalised_rate(np.array([0.0, 1e-12, 1.0, 26.926, 1e6]))
    assert rate[0] == 0.0
    assert (np.diff(rate[1:]) < 0).all()
    assert rate[3] == pytest.approx(0.1 / math.log10(270.26), rel=1e-14)
    with mpmath.workdps(40):
        assert rate[1] == pytest.approx(float(mpmath.mpf("0.1") / mpmath.log10(1 + mpmath.mpf("1e-11"))), rel=1e-12)


@pytest.mark.parametrize(("a", "b"), [(0.0, 1.0), (-1.0, 1.0), (1.0, math.inf), (math.nan, 1.0)])
def test_axes_that_are_no_lengths_are_refused(a, b):
    with pytest.raises(InputError, match="length > 0"):
        surface_term(a, b)


@pytest.mark.parametrize("fraction", [-0.1, 1.1, math.nan])
def test_fractions_outside_0_1_are_refused(fraction):
    with pytest.raises(InputError, match="fraction"):
        attenuation(0.01, 0.015, fraction)


@pytest.mark.parametrize("sigma", [-1.0, math.nan, math.inf])
def test_attenuations_that_are_none_are_refused(sigma):
    with pytest.raises(InputError, match="sigma_t"):
        penalised_rate(np.array([1.0, sigma]))
