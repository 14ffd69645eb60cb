"""Weights and spreads of several models, against likelihoods written out and mixtures drawn by chance."""

import math

import numpy as np
import pytest
from scipy import stats

from livlab.fitting.alternatives import ModelFit, ModelSays, beyond, in_words, spread, weigh
from livlab.optimise.covariance import normal_quantile

X = np.linspace(-1.0, 1.0, 40)


def polynomial(y, degree, sd):
    """χ² (or Σ r²) of the best polynomial, and the residuals."""
    residuals = y - np.polynomial.Polynomial.fit(X, y, degree)(X)
    return float(np.sum((residuals / sd) ** 2)), residuals


def fitted(y, degree, sd=1.0, known=True, rho=0.0):
    return ModelFit(polynomial(y, degree, sd)[0], len(X), degree + 1, rho, known)


def test_with_known_errors_the_criteria_are_those_of_the_likelihood():
    rng = np.random.default_rng(2)
    sd = 0.1
    y = 1.0 + X - 0.8 * X**2 + sd * rng.standard_normal(len(X))
    found = weigh([fitted(y, k, sd) for k in (1, 2, 3)])
    minus_2_log = [-2.0 * stats.norm.logpdf(polynomial(y, k, sd)[1], scale=sd).sum() for k in (1, 2, 3)]
    aic = np.array([m + 2 * (k + 1) for m, k in zip(minus_2_log, (1, 2, 3), strict=True)])
    bic = np.array([m + (k + 1) * math.log(len(X)) for m, k in zip(minus_2_log, (1, 2, 3), strict=True)])
    np.testing.assert_allclose(np.diff(found.aic), np.diff(aic), rtol=1e-10)
    np.testing.assert_allclose(np.diff(found.bic), np.diff(bic), rtol=1e-10)
    np.testing.assert_allclose(found.by_aic, np.exp(-aic / 2) / np.exp(-aic / 2).sum(), rtol=1e-9)
    assert found.by_aic.sum() == pytest.approx(1.0)
    assert found.inflation == 1.0
    assert found.by_bic.argmax() == 1  # the parabola that it is


def test_with_unknown_errors_their_size_is_a_parameter():
    rng = np.random.default_rng(4)
    y = 1.0 + X - 0.8 * X**2 + 0.1 * rng.standard_normal(len(X))
    found = weigh([fitted(y, k, known=False) for k in (1, 2)])
    minus_2_log = []
    for k in (1, 2):
        r = polynomial(y, k, 1.0)[1]
        minus_2_log.append(-2.0 * stats.norm.logpdf(r, scale=math.sqrt(np.mean(r**2))).sum())
    assert np.diff(found.aic)[0] == pytest.approx(minus_2_log[1] - minus_2_log[0] + 2.0, rel=1e-10)
    assert np.diff(found.bic)[0] == pytest.approx(minus_2_log[1] - minus_2_log[0] + math.log(len(X)), rel=1e-10)


def test_points_that_hang_together_count_less():
    y = X**2
    alone = weigh([fitted(y, 0, known=False), fitted(y, 1, known=False)])
    together = weigh([fitted(y, 0, known=False, rho=0.6), fitted(y, 1, known=False, rho=0.6)])
    assert together.numbers == pytest.approx(len(X) * 0.4 / 1.6)
    assert alone.numbers == len(X)
    rng = np.random.default_rng(1)
    noisy = X + 0.3 * rng.standard_normal(len(X))
    pair = [[fitted(noisy, k, known=False, rho=r) for k in (0, 1)] for r in (0.0, 0.6)]
    assert weigh(pair[1]).by_aic[0] > weigh(pair[0]).by_aic[0]  # the same patterns, told by fewer numbers


def test_where_no_model_fits_the_misfit_counts_as_error():
    # χ² 600 and 500 for 30 numbers: taken at its word the second would win by e^50.
    found = weigh([ModelFit(600.0, 30, 3), ModelFit(500.0, 30, 4)])
    assert found.inflation == pytest.approx(500.0 / 26.0)
    assert found.by_aic[0] == pytest.approx(1.0 / (1.0 + math.exp((100.0 / found.inflation - 2.0) / 2.0)), rel=1e-9)
    told = in_words(["as given", "other"], [ModelFit(600.0, 30, 3), ModelFit(500.0, 30, 4)], found, "aic")
    assert "None of the 2 models fits the data within their noise" in told[-1]


def test_the_true_model_gets_the_weight_over_many_draws():
    """A line or a parabola: mean weights of 300 draws each, where the curvature is 4 of its standard errors."""
    rng = np.random.default_rng(8)
    sd, design = 0.2, np.vander(X, 3)
    curvature = 4.0 * sd * math.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    weights = {}
    for c in (0.0, curvature):
        y = 1.0 + X + c * X**2 + sd * rng.standard_normal((300, len(X)))
        weights[c] = np.mean([weigh([fitted(row, k, sd) for k in (1, 2)]).by_bic for row in y], axis=0)
    assert weights[0.0][0] > 0.75
    assert weights[curvature][1] > 0.95


def test_a_colour_has_no_likelihood():
    models = [ModelFit(1.0, 3, 1, likely=False), ModelFit(2.0, 3, 1, likely=False)]
    found = weigh(models)
    assert np.isnan(found.by_aic).all()
    assert "no weights" in in_words(["a", "b"], models, found, "aic")[0]


@pytest.mark.parametrize("weights", [(0.5, 0.5), (0.9, 0.1), (0.99, 0.01), (1.0, 0.0)])
def test_the_interval_over_models_is_that_of_their_mixture(weights):
    said = [ModelSays(1.0, 0.7, 1.1), ModelSays(2.0, 1.9, 2.4)]
    found = spread(said, weights, 0.95)
    rng, z, n = np.random.default_rng(5), normal_quantile(0.95), 400_000
    pick = rng.random(n) >= weights[0]
    normal = rng.standard_normal(n)
    draws = np.empty(n)
    for k, s in enumerate(said):
        here = pick == bool(k)
        below = normal[here] < 0
        draws[here] = s.value + normal[here] * np.where(below, s.value - s.lower, s.upper - s.value) / z
    for told, at in ((found.lower, 0.025), (found.upper, 0.975)):
        assert np.mean(draws < told) == pytest.approx(at, abs=4.0 * math.sqrt(at * (1 - at) / n))
    assert (found.least, found.most, found.models) == (1.0, 2.0, 2)
    assert found.between == pytest.approx(math.sqrt(weights[0] * weights[1]))


def test_without_weights_all_count_alike_and_without_an_interval_there_is_none():
    said = [ModelSays(1.0, 0.9, 1.1), ModelSays(2.0, 1.9, 2.1)]
    assert spread(said, [math.nan, math.nan], 0.95).value == 1.5
    assert math.isnan(spread([*said, ModelSays(3.0, math.nan, math.nan)], [1, 1, 1], 0.95).lower)


def test_what_lies_beyond_an_interval_is_told():
    wide = spread([ModelSays(1.0, 0.9, 1.1), ModelSays(2.0, 1.9, 2.1)], [0.5, 0.5], 0.95)
    told = beyond("blood", {"lower": 0.9, "upper": 1.1}, wide)
    assert "values 1 to 2" in told
    assert "between 0.9 and 1.1 by its own interval" in told
    alike = spread([ModelSays(1.0, 0.9, 1.1), ModelSays(1.01, 0.91, 1.11)], [0.5, 0.5], 0.95)
    assert beyond("blood", {"lower": 0.9, "upper": 1.1}, alike) == ""
