import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from livlab.errors import InputError
from livlab.optimise import Parameter, ParameterSpace, covariance, least_squares, minimise


@pytest.mark.parametrize(
    "wrong",
    [
        {"low": 2, "high": 1},
        {"low": math.nan},
        {"low": 0, "high": 1, "start": 1.5},
        {"start": math.nan},
        {"low": -1, "transform": "log"},
        {"low": 0, "start": 0.0, "transform": "log"},
        {"low": 0, "transform": "logit"},
        {"transform": "square"},
        {"prior_mean": 1.0},
        {"prior_mean": 1.0, "prior_sd": 0.0},
        {"fixed": True},
        {"fixed": True, "start": 1.0, "tied": "y"},
    ],
)
def test_unusable_parameters_are_refused(wrong):
    with pytest.raises(InputError, match="parameter x"):
        Parameter("x", **wrong)


def test_names_and_ties_are_checked():
    with pytest.raises(InputError, match="names must differ"):
        ParameterSpace([Parameter("x"), Parameter("x")])
    with pytest.raises(InputError, match="tied"):
        ParameterSpace([Parameter("x"), Parameter("y", tied="z")])
    with pytest.raises(InputError, match="tied"):
        ParameterSpace([Parameter("x"), Parameter("y", tied="x"), Parameter("z", tied="y")])


@given(st.floats(0.011, 0.99), st.sampled_from(["linear", "log", "logit"]))
def test_values_and_vectors_invert(value, transform):
    space = ParameterSpace([Parameter("x", 0.01, 1.0, 0.5, transform)])
    x = space.vector({"x": value})
    assert space.values(x)["x"] == pytest.approx(value, rel=1e-9)
    step = 1e-6
    slope = (space.values(x + step)["x"] - space.values(x - step)["x"]) / (2 * step)
    assert space.slopes(x)[0] == pytest.approx(slope, rel=1e-4)
    wide = space.rescaled(np.array([7.0]))
    assert wide.values(x / 7.0)["x"] == pytest.approx(value, rel=1e-9)


def test_equal_bounds_leave_nothing_free():
    assert ParameterSpace([Parameter("x", 2, 2)]).names == ()
    assert ParameterSpace([Parameter("x", 2, 2)]).values(np.zeros(0)) == {"x": 2.0}


def test_a_tied_parameter_follows_and_carries_its_slope():
    box = [Parameter("a", 0, 10, 1.0), Parameter("b", tied="a", factor=2.0)]
    found = minimise(
        lambda p: (p["a"] + p["b"] - 6) ** 2,
        box,
        gradient=lambda p: dict.fromkeys("ab", 2 * (p["a"] + p["b"] - 6)),
    )
    assert found.best == pytest.approx({"a": 2, "b": 4})
    assert found.status["b"] == "tied to a"
    spread = covariance(lambda p: 0.5 * (p["a"] + p["b"] - 6) ** 2, box, found.best)
    assert spread.sd == pytest.approx({"a": 1 / 3, "b": 2 / 3}, rel=1e-4)


@pytest.mark.parametrize(("one_sigma", "scale"), [(0.5, 0.5), (1.0, 1.0)])
def test_a_prior_weighs_as_a_measurement_does(one_sigma, scale):
    # A datum 3 ± 1 and a prior 1 ± 0.5 meet at their weighted mean, with the summed information.
    box = [Parameter("m", -10, 10, 0.0, prior_mean=1.0, prior_sd=0.5)]

    def objective(p):
        return scale * (p["m"] - 3.0) ** 2

    mean = (3.0 + 1.0 / 0.25) / (1 + 4)
    found = minimise(objective, box, one_sigma=one_sigma)
    assert found.best["m"] == pytest.approx(mean, abs=1e-6)
    slope = minimise(objective, box, gradient=lambda p: {"m": 2 * scale * (p["m"] - 3)}, one_sigma=one_sigma)
    assert slope.best["m"] == pytest.approx(mean, abs=1e-6)
    assert covariance(objective, box, found.best, one_sigma=one_sigma).sd["m"] == pytest.approx(5**-0.5, rel=1e-4)


def test_priors_enter_least_squares():
    box = [Parameter("m", -10, 10, 0.0, prior_mean=1.0, prior_sd=0.5)]
    assert least_squares(lambda p: np.array([p["m"] - 3.0]), box).best["m"] == pytest.approx(1.4, abs=1e-6)
