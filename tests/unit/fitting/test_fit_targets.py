"""Residuals of a fit's targets against the metrics that they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.fitting.targets import CurveTarget
from livlab.metrics import pearson, rmse

X = np.linspace(0.0, 1.0, 21)
DATA = 0.2 + 0.5 * X**2
MODEL = 0.25 + 0.4 * X
ALL = np.ones(21, dtype=bool)
NAN = np.full(21, np.nan)


def target(**changes: object) -> CurveTarget:
    given: dict[str, object] = {"label": "a", "use": ALL, "data": DATA, "sigma": NAN, "scaling": "none"}
    return CurveTarget(**(given | changes))  # type: ignore[arg-type]


def test_squares_sum_to_the_mean_square() -> None:
    r = target(weight=3.0).residuals(MODEL)
    assert r @ r == pytest.approx(3.0 * rmse(MODEL, DATA) ** 2, rel=1e-12)


def test_squares_sum_to_one_less_pearson() -> None:
    r = target(loss="pearson").residuals(MODEL)
    assert r @ r == pytest.approx(1.0 - pearson(MODEL, DATA), rel=1e-9)


def test_squares_sum_to_chi_square_with_the_models_error() -> None:
    goal = target(loss="chi2", sigma=np.full(21, 0.02))
    r = goal.residuals(MODEL, goal.whitening(MODEL, 0.01**2 * np.eye(21)))
    assert r @ r == pytest.approx(float(np.sum((MODEL - DATA) ** 2 / (0.02**2 + 0.01**2))), rel=1e-12)


@pytest.mark.parametrize("scaling", ["max", "sum", "free"])
@pytest.mark.parametrize("loss", ["rmse", "pearson"])
def test_a_scaled_curve_fits_itself(scaling: str, loss: str) -> None:
    r = target(scaling=scaling, loss=loss).residuals(7.0 * DATA)
    assert np.abs(r).max() < 1e-12


def test_the_free_factor_is_the_best_one() -> None:
    best = target(scaling="free")
    least = float(best.residuals(MODEL) @ best.residuals(MODEL))
    m, _, _ = best.normalised(MODEL)
    factor = m[0] / MODEL[0]
    for nearby in (0.99, 1.01):
        assert rmse(factor * nearby * MODEL, DATA) ** 2 > least


@pytest.mark.parametrize("scaling", ["max", "sum", "free", "none"])
@pytest.mark.parametrize("loss", ["rmse", "pearson", "chi2"])
def test_slopes_are_differences(scaling: str, loss: str) -> None:
    goal = target(scaling=scaling, loss=loss, sigma=np.full(21, 0.02))
    along = np.sin(3 * X) * 40.0
    h = 1e-7
    wanted = (goal.residuals(MODEL + h * along) - goal.residuals(MODEL - h * along)) / (2 * h)
    np.testing.assert_allclose(goal.slope(MODEL, along, None), wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())


def test_the_colour_loss_is_ciede2000() -> None:
    lab = {0.2: np.array([50.0, 2.6772, -79.7751]), 0.7: np.array([50.0, 0.0, -82.7485])}
    goal = target(use=X > 0.99, loss="colour", colour=lambda curve: lab[round(float(curve[0]), 1)])
    # Sharma, Wu & Dalal 2005, Table 1, pair 1; their example curves stand in for two spectra.
    r = goal.residuals(np.full(21, 0.2))
    assert float(r[0]) == pytest.approx(2.0425, abs=5e-5)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"use": X > 2}, "0 points"),
        ({"use": X > 0.94, "loss": "pearson"}, "2 points"),
        ({"data": NAN}, "finite in its band"),
        ({"loss": "chi2"}, "standard deviation"),
        ({"loss": "colour"}, "needs a colour"),
    ],
)
def test_targets_that_cannot_be_compared_are_refused(changes: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word):
        target(**changes)


def test_a_dark_model_is_not_a_number() -> None:
    assert np.isnan(target(scaling="max").residuals(np.zeros(21))).all()
    assert np.isnan(target(loss="pearson").residuals(np.full(21, 0.3))).all()
