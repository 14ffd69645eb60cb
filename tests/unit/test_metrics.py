"""Metrics against closed forms, exact fractions and a published colour table."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from livlab import metrics
from livlab.errors import InputError


def test_mse_and_rmse_by_hand():
    assert metrics.mse([1.0, 2.0, 4.0], [1.0, 0.0, 1.0]) == pytest.approx(13 / 3, rel=1e-15)
    assert metrics.rmse([1.0, 2.0, 4.0], [1.0, 0.0, 1.0]) == pytest.approx(math.sqrt(13 / 3), rel=1e-15)
    assert metrics.squared_error_sum([1.0, 2.0, 4.0], [1.0, 0.0, 1.0]) == 13.0
    assert metrics.mse([1.0, 2.0], [0.0, 0.0], weights=[3.0, 1.0]) == pytest.approx(7 / 4, rel=1e-15)


def test_rmse_neither_underflows_nor_overflows():
    assert metrics.rmse([3e-200, 4e-200], [0, 0]) == pytest.approx(math.sqrt(12.5) * 1e-200, rel=1e-14)
    assert metrics.rmse([3e200, 4e200], [0, 0]) == pytest.approx(math.sqrt(12.5) * 1e200, rel=1e-14)


def test_pearson_against_scipy_and_weights_as_repeats(rng_data):
    a, b = rng_data
    assert metrics.pearson(a, b) == pytest.approx(stats.pearsonr(a, b).statistic, abs=1e-14)
    repeats = np.array([1, 2, 3] * 4)
    direct = metrics.pearson(np.repeat(a, repeats), np.repeat(b, repeats))
    assert metrics.pearson(a, b, weights=repeats) == pytest.approx(direct, abs=1e-14)


def test_pearson_on_a_large_level_against_exact_fractions(rng_data):
    a, b = rng_data
    a, b = a + 1e6, b * 1e-3 + 1e4
    exact = _exact_pearson(a, b)
    assert metrics.pearson(a, b) == pytest.approx(exact, abs=1e-13)
    # The one-pass formula loses what the two-pass one keeps: the check can fail.
    n = len(a)
    one_pass = (n * (a @ b) - a.sum() * b.sum()) / math.sqrt(
        (n * (a @ a) - a.sum() ** 2) * (n * (b @ b) - b.sum() ** 2)
    )
    assert abs(one_pass - exact) > 1e-6


def test_pearson_of_extreme_scales(rng_data):
    a, b = rng_data
    assert metrics.pearson(a * 1e-200, b * 1e200) == pytest.approx(metrics.pearson(a, b), abs=1e-14)


@pytest.mark.parametrize(
    ("a", "b", "says"),
    [
        ([1, 1, 1], [1, 2, 3], "values.*is constant: it has no Pearson"),
        ([1, 2, 3], [0, 0, 0], "reference.*is constant"),
        ([1, 1 + 1e-12, 1], [1, 2, 3], "nearly constant"),
        ([1, float("nan"), 2], [1, 2, 3], r"values\[1\] = nan: must be a finite"),
        ([1, 2, 3], [1, float("inf"), 2], r"reference\[1\]"),
        ([1, 2, 3, 4], [1, 2, 3], "as long as the reference"),
        ([1, 2], [1, 2], "at least 3"),
        ([[1, 2, 3]], [1, 2, 3], "one-dimensional"),
        (["x", 1, 2], [1, 2, 3], "must be numbers"),
    ],
)
def test_pearson_refuses(a, b, says):
    with pytest.raises(InputError, match=says):
        metrics.pearson(a, b)


def test_weights_are_checked():
    for bad in ([1, -1, 1], [0, 0, 0], [1, 1], [1, float("nan"), 1]):
        with pytest.raises(InputError, match="weights"):
            metrics.mse([1, 2, 3], [1, 2, 3], weights=bad)
    with pytest.raises(InputError, match="at least 3 points"):
        metrics.pearson([1, 2, 3], [1, 3, 2], weights=[1, 1, 0])


def test_a_constant_is_judged_on_the_points_that_count():
    with pytest.raises(InputError, match="is constant"):
        metrics.pearson([9, 1, 1, 1], [1, 2, 3, 4], weights=[0, 1, 1, 1])


def test_amplitude_and_its_ratio():
    assert metrics.amplitude([-1.0, 3.0, 0.5]) == 4.0
    assert metrics.amplitude_ratio([0.0, 1.0], [1.0, 3.0]) == 0.5
    with pytest.raises(InputError, match="no ratio"):
        metrics.amplitude_ratio([0.0, 1.0], [2.0, 2.0])


def test_normalise():
    assert metrics.normalise([1.0, 3.0], "sum").tolist() == [0.25, 0.75]
    assert metrics.normalise([1.0, 4.0], "max").tolist() == [0.25, 1.0]
    assert metrics.normalise([1.0, 4.0], "none").tolist() == [1.0, 4.0]
    for values, by in ([[0.0, 0.0], "max"], [[-1.0, 1.0], "sum"], [[-2.0, -1.0], "max"]):
        with pytest.raises(InputError, match="must be above 0"):
            metrics.normalise(values, by)
    with pytest.raises(InputError, match="'max', 'sum' or 'none'"):
        metrics.normalise([1.0], "mean")


# Sharma, Wu & Dalal, Color Res. Appl. 30:21, 2005, Table 1, seven of its pairs.
SHARMA = [
    ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
    ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0000),
    ((50, 0, 0), (50, -1, 2), 2.3669),
    ((50, -0.001, 2.49), (50, 0.0011, -2.49), 4.7461),
    ((50, 2.5, 0), (73, 25, -18), 27.1492),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]


@pytest.mark.parametrize(("a", "b", "expected"), SHARMA)
def test_ciede2000_meets_the_published_pairs(a, b, expected):
    assert float(metrics.colour_difference(a, b)) == pytest.approx(expected, abs=5e-5)
    assert float(metrics.colour_difference(b, a)) == pytest.approx(expected, abs=5e-5)


def test_colour_difference_broadcasts_and_refuses():
    many = metrics.colour_difference(np.tile([50.0, 0.0, 0.0], (4, 5, 1)), [50.0, 0.0, 0.0])
    assert many.shape == (4, 5)
    assert (many == 0).all()
    with pytest.raises(InputError, match="axis of 3"):
        metrics.colour_difference([1.0, 2.0], [1.0, 2.0])
    with pytest.raises(InputError, match="finite"):
        metrics.colour_difference([1.0, 2.0, float("nan")], [1.0, 2.0, 3.0])


def test_bootstrap_refuses():
    for arguments, says in [
        ({"level": 1.0}, "level"),
        ({"resamples": 5}, "resamples"),
        ({"values_error": [1.0, -1.0]}, "negative"),
        ({"values_error": [1.0]}, "shape"),
        ({"values_error": [[1.0, 2.0], [0.0, 1.0]]}, "symmetric"),
        ({"values_error": [[1.0, 2.0], [2.0, 1.0]]}, "eigenvalue"),
        ({"reference_errors": "scale"}, "independent"),
    ]:
        with pytest.raises(InputError, match=says):
            metrics.bootstrap_interval(metrics.rmse, [1.0, 2.0], [1.0, 3.0], **arguments)


def test_bootstrap_is_seeded():
    draw = [
        metrics.bootstrap_interval(metrics.rmse, [1.0, 2.0], [1.0, 3.0], values_error=[0.1, 0.1], seed=s)
        for s in (1, 1, 2)
    ]
    assert draw[0] == draw[1]
    assert draw[0].standard_error != draw[2].standard_error


@pytest.fixture
def rng_data():
    rng = np.random.default_rng(4)
    a = rng.normal(size=12)
    return a, 0.6 * a + rng.normal(size=12)


def _exact_pearson(a, b):
    fa, fb = ([Fraction(float(x)) for x in v] for v in (a, b))
    ma, mb = sum(fa) / len(fa), sum(fb) / len(fb)
    saa, sbb = sum((x - ma) ** 2 for x in fa), sum((x - mb) ** 2 for x in fb)
    return float(sum((x - ma) * (y - mb) for x, y in zip(fa, fb, strict=True))) / math.sqrt(saa * sbb)
