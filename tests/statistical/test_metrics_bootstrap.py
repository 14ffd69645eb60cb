"""Bootstrap errors against closed forms, and error propagation against repeated noise."""

import numpy as np
import pytest

from livlab import curves, metrics
from livlab.curves import Curve

B = 4000
SE_OF_SD = 1 / np.sqrt(2 * B)  # relative standard error of a standard deviation over B normal draws


def mean_difference(a, b):
    return float(np.mean(a - b))


def test_independent_errors_average_out():
    n = 25
    got = metrics.bootstrap_interval(
        mean_difference, np.zeros(n), np.zeros(n), values_error=np.full(n, 0.3), reference_error=np.full(n, 0.4),
        resamples=B,
    )  # fmt: skip
    assert got.standard_error == pytest.approx(0.5 / 5, rel=4 * SE_OF_SD)
    assert got.high - got.low == pytest.approx(2 * 1.96 * 0.1, rel=0.06)


def test_a_common_error_does_not():
    n = 25
    got = metrics.bootstrap_interval(
        mean_difference, np.zeros(n), np.zeros(n), reference_error=np.full(n, 0.4), reference_errors="common",
        resamples=B,
    )  # fmt: skip
    assert got.standard_error == pytest.approx(0.4, rel=4 * SE_OF_SD)


def test_a_common_scale_leaves_pearson_alone():
    a, b = np.linspace(0, 1, 12) ** 2, np.linspace(0.2, 1, 12)
    common = metrics.bootstrap_interval(
        metrics.pearson, a, b, reference_error=0.1 * b, reference_errors="common", resamples=500
    )
    independent = metrics.bootstrap_interval(metrics.pearson, a, b, reference_error=0.1 * b, resamples=500)
    assert common.standard_error < 1e-12
    assert independent.standard_error > 1e-3
    assert independent.bias < 0


def test_covariance_is_honoured():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 2))  # rank 2: singular, as a smoothed curve's is
    weights = rng.normal(size=6)
    got = metrics.bootstrap_interval(
        lambda a, b: float(weights @ a), np.zeros(6), np.zeros(6), values_error=root @ root.T, resamples=B
    )
    assert got.standard_error == pytest.approx(np.linalg.norm(weights @ root), rel=4 * SE_OF_SD)


def test_interval_covers_as_often_as_it_says():
    """300 experiments at 90 %: 270 ± 5.2 covered; 4 standard errors allowed, 85 % would be refused at 3.3."""
    rng = np.random.default_rng(11)
    truth, noise, n, hits, runs = 0.7, 0.2, 10, 0, 300
    for k in range(runs):
        seen = truth + noise * rng.normal(size=n)
        got = metrics.bootstrap_interval(
            mean_difference, seen, np.zeros(n), values_error=np.full(n, noise), level=0.9, resamples=400, seed=k
        )
        hits += got.low <= truth <= got.high
    assert abs(hits - 0.9 * runs) <= 4 * np.sqrt(runs * 0.9 * 0.1)


@pytest.mark.parametrize("by", ["max", "sum", "none"])
@pytest.mark.parametrize("alignment", ["centred", "left"])
def test_propagated_errors_match_repeated_noise(by, alignment):
    """20 000 noisy curves: each SD known to 0.5 %; first-order propagation at 0.5 % noise is good to 1e-4."""
    rng = np.random.default_rng(5)
    grid = curves.regular_grid(500, 720, 20)
    value = 0.05 + 0.1 / (1 + np.exp(-(grid - 600) / 15))
    error = 0.005 * value.max() * np.linspace(0.5, 1.5, 12)
    curve = Curve.of(grid, value, error)
    done = curves.thesis_curve(curve, alignment=alignment, by=by)
    repeats = 20_000
    fine = curves.regular_grid(500, 720, 5)
    chain = curves.moving_average_matrix(len(fine), 4, alignment) @ curves.interpolation_matrix(grid, fine)
    noisy = (value + error * rng.normal(size=(repeats, 12))) @ chain.T
    if by == "max":
        noisy /= noisy[:, [int(np.argmax(chain @ value))]]
    elif by == "sum":
        noisy /= noisy.sum(axis=1, keepdims=True)
    found = noisy.std(axis=0, ddof=1)
    scale = done.standard_error.max()
    assert np.max(np.abs(found - done.standard_error)) < (4.5 / np.sqrt(2 * repeats) + 0.005) * scale
    # Power: leaving the covariances out, as if each point were on its own, is refused.
    naive = np.sqrt(np.square(chain) @ np.square(error)) / (value.max() if by == "max" else 1)
    if by == "max":
        assert np.max(np.abs(found - naive)) > 0.1 * scale
