"""Intervals of fits: they hold the truth as often as they say, also at bounds and along valleys, and the test can fail.

Of n intervals at level p, n p hold the truth, give or take √(n p (1 − p)).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fit_forwards import Walked

from livlab.errors import InputError
from livlab.fitting.fit import fit
from livlab.fitting.intervals import Profiler
from livlab.fitting.options import FitOptions
from livlab.fitting.problem import Problem
from livlab.fitting.targets import CurveTarget
from livlab.kinds.fit import coverage as fit_coverage
from livlab.kinds.fit.round_trip import Trip, round_trip
from livlab.optimise import Parameter, ParameterSpace, profile

X = np.linspace(0.0, 2.0, 21)
ALL = np.ones(21, dtype=bool)

SPACE = ParameterSpace([Parameter("a", 0.5, 3.0, 1.5), Parameter("k", 0.3, 3.0, 1.0, "log"), Parameter("c", 0.0, 1.0)])
TARGET = CurveTarget("made", ALL, 1.0 + X, 0.03 * (1.0 + X), "none", "chi2")


def trips(forward: Any, count: int, *, target: CurveTarget = TARGET, space: ParameterSpace = SPACE) -> list[Trip]:
    return [
        round_trip(
            forward,
            [target],
            space,
            FitOptions(seed=100_000 * (i + 1), most_recordings=2),
            relative_sd=None,
            rng=np.random.default_rng([11, i]),
        )
        for i in range(count)
    ]


@pytest.fixture(scope="module")
def honest() -> list[Trip]:
    return trips(Walked(), 150)


def test_intervals_hold_the_truth_as_often_as_they_say(honest: list[Trip]) -> None:
    # 450 intervals of 150 tissues: 0.95 ± 0.0178 if a tissue's three hold or fail together; 0.90 would be found out.
    found = fit_coverage.overall(honest)
    assert found is not None
    share, error = found
    assert error == pytest.approx(np.sqrt(share * (1 - share) / 450), rel=0.1)
    assert abs(share - 0.95) < 2.5 * np.sqrt(0.95 * 0.05 / 150)
    _, rows = fit_coverage.by_parameter(honest, {})
    for row in rows:
        low, high = fit_coverage.binomial(int(str(row["inside"])), 150, level=0.998)
        assert low <= 0.95 <= high, row


def test_chi_square_at_the_truth_has_its_mean(honest: list[Trip]) -> None:
    # Errors of data, of the walk that simulates them and of the walk that fits them: χ² of 21 numbers, ± √(42/150).
    assert np.mean([t.chi2_truth for t in honest]) == pytest.approx(21.0, abs=4 * np.sqrt(42 / 150))
    assert np.mean([t.chi2_best for t in honest]) == pytest.approx(18.0, abs=4 * np.sqrt(36 / 150) + 0.5)


def test_errors_of_the_walk_that_nobody_counts_are_found_out() -> None:
    # The same with the walk's errors kept secret: the intervals claim too much, and the count says so.
    found = fit_coverage.overall(trips(Walked(sd=0.03, told=0.0), 60))
    assert found is not None
    assert found[0] < 0.85


def test_what_a_shape_cannot_hold_is_named() -> None:
    space = ParameterSpace([Parameter("a", 0.5, 3.0), Parameter("k", 0.3, 3.0, None, "log"), Parameter("c", 0.0, 1e-9)])
    found = trips(Walked(sd=1e-4), 20, target=replace(TARGET, scaling="free"), space=space)
    told = " ".join(fit_coverage.sentences(found, {"a": "amplitude", "k": "rate"}))
    assert "amplitude cannot be identified" in told
    assert "rate" not in told
    _, rows = fit_coverage.by_parameter(found, {})
    assert rows[0]["verdict"] == "not identifiable"
    assert rows[1]["verdict"] == "identifiable"


@pytest.mark.parametrize("scaling", ["none", "free", "max", "sum"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ends_are_those_of_the_profile_walked_step_by_step(scaling: str, seed: int) -> None:
    forward, rng = Walked(sd=1e-3), np.random.default_rng(seed)
    data = 1.2 * np.exp(-1.1 * X) + 0.1 + 0.05 * rng.standard_normal(21)
    target = CurveTarget("made", ALL, data, np.full(21, 0.05), scaling, "chi2")  # type: ignore[arg-type]
    found = fit(Problem(forward, [target], SPACE))
    problem = Problem(forward, [target], SPACE, eager=True)
    problem.freeze_errors(found.best)
    quick = Profiler(problem, SPACE, found.best)
    for p in SPACE.free:
        slow = profile(
            lambda v: 0.5 * float(np.sum(problem.residuals(v) ** 2)),
            SPACE,
            found.best,
            p.name,
            level=0.95,
            gradient=lambda v: {k: float(j @ problem.residuals(v)) for k, j in problem.jacobian(v).items()},
        )
        before = problem.evaluations
        interval = quick.interval(p.name, 1.959964**2)
        assert problem.evaluations - before < 40
        wide = p.high - p.low
        assert interval.lower == pytest.approx(slow.lower, abs=0.01 * wide)
        assert interval.upper == pytest.approx(slow.upper, abs=0.01 * wide)
        assert (interval.open_below, interval.open_above) == (slow.open_below, slow.open_above)
        assert not interval.rough


def test_a_prior_is_a_part_of_the_interval() -> None:
    flat = CurveTarget("made", ALL, np.full(21, 1.0), np.full(21, 0.02), "free", "chi2")
    known = ParameterSpace([Parameter("a", 0.5, 3.0, prior_mean=1.5, prior_sd=0.1), *SPACE.parameters[1:]])
    found = fit(Problem(Walked(sd=1e-4), [replace(flat, data=1.5 * np.exp(-X) + 0.3)], known))
    low, high = found.intervals().loc["a", ["lower", "upper"]]
    assert high - low == pytest.approx(2 * 1.96 * 0.1, rel=0.1)


def test_a_loss_without_a_likelihood_is_refused() -> None:
    with pytest.raises(InputError, match="no likelihood"):
        trips(Walked(), 1, target=replace(TARGET, loss="rmse"))
