"""The fit's loop on a forward model in closed form: fresh draws, intervals, bounds, faults."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fit_forwards import Decay

from livlab.errors import InputError, Interrupted
from livlab.fitting.fit import fit
from livlab.fitting.options import FitOptions
from livlab.fitting.problem import Problem
from livlab.fitting.targets import CurveTarget
from livlab.optimise import Parameter

X = np.linspace(0.0, 2.0, 41)
ALL = np.ones(41, dtype=bool)


PARAMETERS = [Parameter("a", 0.1, 10.0, 1.0, transform="log"), Parameter("k", 0.1, 5.0, 0.5)]


def curve(rng: np.random.Generator | None = None, sd: float = 0.0) -> Any:
    clean = 2.0 * np.exp(-1.3 * X)
    return clean if rng is None else clean + sd * rng.standard_normal(41)


def aim(data: Any, **changes: Any) -> CurveTarget:
    return CurveTarget(
        "made", ALL, data, np.full(41, changes.pop("sd", np.nan)), changes.pop("scaling", "none"), **changes
    )


def test_an_exact_curve_gives_back_its_parameters() -> None:
    forward = Decay()
    found = fit(Problem(forward, [aim(curve())], PARAMETERS))
    assert found.best["a"] == pytest.approx(2.0, rel=1e-5)
    assert found.best["k"] == pytest.approx(1.3, rel=1e-5)
    assert found.settled
    assert len(forward.records) == 2
    assert len(set(forward.records)) == 2


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    # 200 noisy curves: a 90 % interval holds the truth in 180 of them, ±13 at three standard deviations.
    rng = np.random.default_rng(5)
    held = np.zeros(2)
    for _ in range(200):
        found = fit(
            Problem(Decay(), [aim(curve(rng, 0.05), sd=0.05, loss="chi2")], PARAMETERS),
            FitOptions(most_recordings=2, level=0.9),
        )
        frame = found.intervals()
        for j, (name, truth) in enumerate((("a", 2.0), ("k", 1.3))):
            held[j] += frame.loc[name, "lower"] <= truth <= frame.loc[name, "upper"]
    assert np.all(np.abs(held - 180) <= 13), held


def test_unknown_errors_are_estimated_from_the_residuals() -> None:
    rng = np.random.default_rng(8)
    data = curve(rng, 0.05)
    known = fit(Problem(Decay(), [aim(data, sd=0.05, loss="chi2")], PARAMETERS))
    guessed = fit(Problem(Decay(), [aim(data)], PARAMETERS))
    assert guessed.best["k"] == pytest.approx(known.best["k"], rel=1e-3)
    # Independent noise: about the same spread, up to the 11 % by which 41 residuals know it and chance correlation.
    assert guessed.covariance.sd["k"] == pytest.approx(known.covariance.sd["k"], rel=0.5)


def test_smooth_misfit_widens_the_intervals() -> None:
    rough = 0.05 * np.random.default_rng(1).standard_normal(41)
    smooth = 0.05 * np.sqrt(2.0) * np.sin(6.0 * X)
    first, second = (fit(Problem(Decay(), [aim(curve() + off)], PARAMETERS)) for off in (rough, smooth))
    assert second.autocorrelation > 0.8 > 0.4 > abs(first.autocorrelation)
    assert second.covariance.sd["k"] > 2.0 * first.covariance.sd["k"]


def test_noise_of_the_forward_model_is_told() -> None:
    # 5 % noise in every recording against data of .1 %: fresh draws move the optimum by far more than its σ says.
    loud = fit(Problem(Decay(noise=0.05), [aim(curve())], PARAMETERS), FitOptions(most_recordings=3))
    assert len(loud.searches) == 3 or loud.settled
    assert abs(loud.drift["k"]) > 1e-4
    assert loud.fresh_loss > 0


def test_a_parameter_at_its_bound_has_an_open_interval_and_is_named() -> None:
    tight = [PARAMETERS[0], Parameter("k", 0.1, 1.0, 0.5)]
    found = fit(Problem(Decay(), [aim(curve())], tight))
    assert found.intervals().loc["k", "status"] == "at upper bound"
    assert found.intervals().loc["k", "open"] == "above"
    assert 0.1 < found.intervals().loc["k", "lower"] < found.intervals().loc["k", "upper"] == 1.0
    assert any("upper bound" in note for note in found.notes)


def test_a_shape_alone_leaves_the_amplitude_open() -> None:
    found = fit(Problem(Decay(), [aim(curve(), scaling="max", sd=0.01, loss="chi2")], PARAMETERS))
    assert found.best["k"] == pytest.approx(1.3, rel=1e-4)
    assert found.verdict.verdict == "not held"
    assert "a" in found.verdict.alone


def test_a_curve_that_nothing_answers_is_an_error() -> None:
    with pytest.raises(InputError, match="finite"):
        fit(Problem(Decay(dead=True), [aim(curve())], PARAMETERS))


def test_nothing_to_fit_is_refused() -> None:
    with pytest.raises(InputError, match="at least one must be free"):
        fit(Problem(Decay(), [aim(curve())], [Parameter("a", 1.0, 1.0), Parameter("k", 0.1, 5.0, 1.0, fixed=True)]))
    with pytest.raises(InputError, match="at least one must be fitted"):
        fit(Problem(Decay(), [], PARAMETERS))


def test_the_user_can_stop_it() -> None:
    with pytest.raises(Interrupted):
        fit(Problem(Decay(), [aim(curve())], PARAMETERS), stopping=lambda: True)


def test_two_curves_hold_more_than_one() -> None:
    early, late = X < 0.3, X >= 1.7
    sigma = np.full(41, 0.02)
    first = CurveTarget("early", early, curve(), sigma, "none", "chi2")
    second = CurveTarget("late", late, curve(), sigma, "none", "chi2")
    alone, both = fit(Problem(Decay(), [first], PARAMETERS)), fit(Problem(Decay(), [first, second], PARAMETERS))
    assert both.covariance.sd["k"] < 0.5 * alone.covariance.sd["k"]


def test_the_same_seed_gives_the_same_fit() -> None:
    first, second = (
        fit(Problem(Decay(noise=0.01), [aim(curve())], PARAMETERS), FitOptions(seed=7)).best for _ in range(2)
    )
    assert first == second
