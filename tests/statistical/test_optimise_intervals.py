"""Do the intervals cover what they say? On a linear-Gaussian model, where they are exact, and beyond it."""

import numpy as np
import pytest
from scipy import stats

from livlab.errors import InputError
from livlab.optimise import (
    Parameter,
    block_weights,
    bootstrap,
    covariance,
    covariance_of_residuals,
    identifiability,
    least_squares,
    profile,
)

X = np.linspace(-1, 1, 40)
BOX = [Parameter("a", -50, 50, 0.0), Parameter("b", -50, 50, 0.0)]
TRUTH = {"a": 1.5, "b": -0.7}
SD = 0.3


def line(p):
    return p["a"] + p["b"] * X


def nll(y):
    return lambda p: 0.5 * float(np.sum(((line(p) - y) / SD) ** 2))


def test_intervals_of_covariance_and_profile_cover_as_often_as_they_say():
    rng = np.random.default_rng(11)
    draws, level = 400, 0.6827
    hits = {"covariance": 0, "profile": 0}
    profiled = 0
    for k in range(draws):
        y = line(TRUTH) + SD * rng.standard_normal(X.size)
        found = least_squares(lambda p, y=y: (line(p) - y) / SD, BOX)
        row = covariance(nll(y), BOX, found.best).intervals(level).loc["b"]
        hits["covariance"] += row["lower"] <= TRUTH["b"] <= row["upper"]
        if k < 60:
            span = profile(nll(y), BOX, found.best, "b", level=level, step=0.05)
            profiled += 1
            hits["profile"] += span.lower <= TRUTH["b"] <= span.upper
            # On a linear model both are the same interval.
            assert span.lower == pytest.approx(row["lower"], abs=2e-3 * SD)
            assert span.upper == pytest.approx(row["upper"], abs=2e-3 * SD)
    test = stats.binomtest(hits["covariance"], draws, level)
    assert test.pvalue > 0.003
    # Power: an interval 25 % too narrow or too wide would be caught in nine cases of ten.
    for factor in (0.75, 1.25):
        wrong = 2 * stats.norm.cdf(factor * stats.norm.ppf(0.5 + level / 2)) - 1
        counts = np.arange(draws + 1)
        refused = np.array([stats.binomtest(int(c), draws, level).pvalue <= 0.003 for c in counts])
        assert stats.binom.pmf(counts, draws, wrong)[refused].sum() > 0.9


def test_covariance_is_the_textbook_one():
    y = line(TRUTH) + SD * np.random.default_rng(1).standard_normal(X.size)
    found = least_squares(lambda p: (line(p) - y) / SD, BOX)
    design = np.stack([np.ones_like(X), X], axis=1)
    expected = SD**2 * np.linalg.inv(design.T @ design)
    numeric = covariance(nll(y), BOX, found.best)
    np.testing.assert_allclose(numeric.matrix.to_numpy(), expected, rtol=1e-5, atol=1e-9)
    exact = covariance_of_residuals({"a": np.ones_like(X) / SD, "b": X / SD}, BOX, found.best)
    np.testing.assert_allclose(exact.matrix.to_numpy(), expected, rtol=1e-10, atol=1e-15)


def test_log_parameters_keep_intervals_positive_and_right():
    # ln p measured with sd 0.8: the interval of p is p exp(±0.8).
    box = [Parameter("p", 1e-6, 1e6, 1.0, "log")]

    def objective(v):
        return 0.5 * (np.log(v["p"] / 3.0) / 0.8) ** 2

    row = covariance(objective, box, {"p": 3.0}).intervals().loc["p"]
    assert row["lower"] == pytest.approx(3 * np.exp(-0.8), rel=1e-3)
    assert row["upper"] == pytest.approx(3 * np.exp(0.8), rel=1e-3)
    span = profile(objective, box, {"p": 3.0}, "p")
    assert span.lower == pytest.approx(3 * np.exp(-0.8), rel=2e-3)


def test_profile_follows_a_lopsided_objective_and_tells_an_open_side():
    box = [Parameter("r", 0, 5, 1.0), Parameter("s", -3, 3, 0.0)]

    def objective(p):
        rise = 8 * (p["r"] - 1) ** 2 if p["r"] < 1 else 0.02 * (p["r"] - 1) ** 2
        return rise + (p["s"] - 0.5 * p["r"]) ** 2

    span = profile(objective, box, {"r": 1.0, "s": 0.5}, "r", step=0.1)
    assert span.lower == pytest.approx(0.75, abs=2e-3)
    assert span.open_above
    assert span.upper == 5
    assert not span.open_below


def test_profile_reports_a_better_minimum():
    box = [Parameter("r", -3, 3, 1.0)]
    span = profile(lambda p: (p["r"] ** 2 - 1) ** 2 + 0.2 * p["r"], box, {"r": 0.97}, "r", step=0.3, level=0.999)
    assert span.lower_minimum is not None
    assert span.lower_minimum["r"] < 0


def test_bootstrap_by_blocks_sees_what_hangs_together():
    rng = np.random.default_rng(8)
    labels = np.repeat(np.arange(40), 25)
    y = 2.0 + 0.5 * rng.standard_normal(40)[labels] + 0.1 * rng.standard_normal(labels.size)

    def refit(weights):
        return {"mean": float(np.average(y, weights=weights))}

    alone = bootstrap(refit, np.arange(y.size), replicates=400, seed=1)
    blocks = bootstrap(refit, labels, replicates=400, seed=1)
    expected = np.array([y[labels == k].mean() for k in range(40)]).std(ddof=1) / 40**0.5
    assert blocks.sd["mean"] == pytest.approx(expected, rel=0.12)  # 3.4 standard errors of 400 replicates
    assert alone.sd["mean"] < 0.35 * expected
    row = blocks.intervals(0.95).loc["mean"]
    assert row["lower"] < 2.0 < row["upper"]


def test_block_weights_are_counts_of_whole_blocks():
    labels = np.array([3, 3, 9, 9, 9, 5])
    weights = block_weights(labels, np.random.default_rng(2))
    for k in (3, 9, 5):
        assert np.unique(weights[labels == k]).size == 1
    assert sum(weights[labels == k][0] for k in (3, 9, 5)) == 3


def test_bootstrap_counts_failures_and_refuses_what_cannot_be_resampled():
    calls = iter(range(100))

    def refit(weights):
        if next(calls) % 3 == 0:
            raise InputError.of("y", 0, "no", "no")
        return {"m": float(weights.sum())}

    assert bootstrap(refit, np.arange(9), replicates=30).failures == 10
    with pytest.raises(InputError, match="at least two blocks"):
        bootstrap(refit, np.zeros(9))


def test_a_product_that_alone_is_measured_is_named():
    x = np.linspace(0.1, 1, 30)
    box = [Parameter("ks", 1e-3, 10, 1.0, "log"), Parameter("F0", 1e-3, 10, 1.0, "log"), Parameter("c", -5, 5, 0.0)]

    def objective(p):
        return 0.5 * float(np.sum((p["ks"] * p["F0"] * x + p["c"] - 2 * x) ** 2)) / 1e-4

    verdict = identifiability(covariance(objective, box, {"ks": 2.0, "F0": 1.0, "c": 0.0}))
    assert verdict.verdict == "not held"
    assert set(verdict.combination) == {"ks", "F0"}
    assert verdict.combination["ks"] == pytest.approx(-verdict.combination["F0"], rel=1e-3)
    assert "ks" in verdict.sentences[0]
    assert "F0" in verdict.sentences[0]


def test_a_parameter_that_is_not_measured_is_named_and_has_no_sd():
    box = [Parameter("a", -5, 5, 0.0), Parameter("idle", 0, 1, 0.5)]
    found = covariance(lambda p: 0.5 * p["a"] ** 2, box, {"a": 0.0, "idle": 0.5})
    assert np.isinf(found.sd["idle"])
    assert found.sd["a"] == pytest.approx(1.0, rel=1e-4)
    verdict = identifiability(found)
    assert verdict.alone == ("idle",)
    assert not verdict


def test_well_measured_parameters_are_held_and_one_at_a_bound_is_left_out():
    box = [Parameter("a", -5, 5, 0.0), Parameter("b", 0, 1, 0.5)]
    found = covariance(lambda p: 0.5 * ((p["a"] / 0.1) ** 2 + (p["b"] / 0.1) ** 2), box, {"a": 0.0, "b": 0.0})
    assert found.held == ("b",)
    assert list(found.matrix.index) == ["a"]
    assert identifiability(found).verdict == "held"
