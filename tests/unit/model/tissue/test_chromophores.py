"""Chromophores against high-precision arithmetic, published numbers and their limits."""

import math

import mpmath
import numpy as np
import pytest

from livlab import datasets
from livlab.errors import InputError
from livlab.model.tissue.chromophores import blood, exponential_law, mixture, packaging, power_law, whole_blood


@pytest.mark.parametrize("depth", [1e-300, 1e-17, 1e-12, 1e-8, 1e-4, 0.1, 1.0, 20.0, 800.0, 1e12])
def test_packaging_agrees_with_50_digits_from_no_to_full_shadow(depth):
    with mpmath.workdps(50):
        y = mpmath.mpf(depth)
        exact = float(-mpmath.expm1(-y) / y)
    assert packaging(0.5, np.array([depth]))[0] == pytest.approx(exact, rel=4e-16)


def test_packaging_is_one_without_absorber_or_vessel_and_falls_as_one_over_depth():
    sigma = np.array([0.0, 1.0, 1e9])
    assert packaging(0.0, sigma).tolist() == [1.0, 1.0, 1.0]
    assert packaging(0.05, np.zeros(2)).tolist() == [1.0, 1.0]
    assert packaging(0.05, np.array([1e9]))[0] * 2 * 0.05 * 1e9 == pytest.approx(1.0, rel=1e-12)
    assert packaging(0.05, np.array([np.inf]))[0] == 0.0


def test_packaging_depends_on_the_product_of_radius_and_absorption_only():
    # R in cm with 1/cm and R in mm with 1/mm are the same number; R in µm with 1/cm would not be.
    assert packaging(0.05, np.array([20.0]))[0] == packaging(0.005, np.array([200.0]))[0]


def test_whole_blood_has_prahls_factor():
    one = whole_blood(1.0, np.array([1.0]), np.array([7.0]))
    assert one[0] * 10 == pytest.approx(0.0053558, rel=2e-5)
    assert whole_blood(0.0, np.array([7.0]), np.array([1.0])) == pytest.approx(one, rel=1e-15)


def test_blood_absorbs_equally_at_the_isosbestic_point_whatever_its_oxygenation():
    table = datasets.load("haemoglobin_prahl")
    wavelength = np.arange(795.0, 801.0, 0.01)
    hbo2, hb = table.interpolate("hbo2", wavelength), table.interpolate("hb", wavelength)
    k = int(np.argmin(np.abs(hbo2 - hb)))
    values = [whole_blood(s, hbo2[k : k + 1], hb[k : k + 1])[0] for s in (0.0, 0.3, 1.0)]
    assert np.ptp(values) < 1e-4 * values[0]


def test_blood_without_a_fraction_absorbs_nothing():
    assert blood(0.0, np.array([10.0]), 0.05).tolist() == [0.0]


def test_mixture_is_the_sum_of_its_parts():
    parts = [np.array([10.0, 20.0]), np.array([1.0, 3.0])]
    assert mixture(0.779, [0.019, 0.981], parts) == pytest.approx([0.779 * 1.171, 0.779 * 3.323], rel=1e-14)


def test_laws_meet_their_reference_and_their_slopes():
    wavelength = np.array([400.0, 500.0, 800.0])
    power = power_law(wavelength, 3.0, 3.33, 500.0)
    assert power[1] == 3.0
    assert math.log(power[2] / power[0]) / math.log(2.0) == pytest.approx(-3.33, rel=1e-12)
    decay = exponential_law(wavelength, 3.0, 66.2, 500.0)
    assert math.log(decay[0] / decay[2]) == pytest.approx(400.0 / 66.2, rel=1e-12)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: packaging(-1.0, np.ones(1)), "vessel radius"),
        (lambda: packaging(math.nan, np.ones(1)), "vessel radius"),
        (lambda: packaging(1.0, np.array([1.0, -2.0])), "absorption"),
        (lambda: whole_blood(1.2, np.ones(1), np.ones(1)), "oxygenation"),
        (lambda: whole_blood(0.5, -np.ones(1), np.ones(1)), "HbO2"),
        (lambda: whole_blood(0.5, np.ones(1), np.ones(1), -150.0), "haemoglobin"),
        (lambda: blood(-0.1, np.ones(1), 0.05), "fraction"),
        (lambda: mixture(0.5, [0.7, 0.7], [np.ones(1), np.ones(1)]), "shares"),
        (lambda: mixture(0.5, [-0.1], [np.ones(1)]), "share"),
    ],
)
def test_what_cannot_be_is_refused_by_name(call, field):
    with pytest.raises(InputError, match=field):
        call()
