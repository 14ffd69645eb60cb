"""Global algorithms lead a fit out of a wrong valley; ties, fixed values and priors hold at the fit's own level."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from fit_forwards import Wave

from livlab.errors import InputError
from livlab.fitting.fit import fit
from livlab.fitting.options import FitOptions
from livlab.fitting.problem import Problem
from livlab.fitting.targets import CurveTarget
from livlab.optimise import Parameter

X = np.linspace(0.0, 2.0, 41)
ALL = np.ones(41, dtype=bool)


PARAMETERS = [Parameter("a", 0.5, 2.0, 1.2), Parameter("k", 1.0, 20.0, 3.0)]
TARGET = CurveTarget("wave", ALL, 1.0 * (2.0 + np.cos(13.0 * X)), np.full(41, 0.05), "none", "chi2")


def test_a_local_search_stays_in_its_valley() -> None:
    found = fit(Problem(Wave(), [TARGET], PARAMETERS))
    assert abs(found.best["k"] - 13.0) > 1.0


@pytest.mark.parametrize("name", ["GN_CRS2_LM", "GN_DIRECT_L", "G_MLSL_LDS", "GN_ISRES", "GN_AGS"])
@pytest.mark.parametrize("local", ["LN_BOBYQA", "LN_SBPLX", "LD_SLSQP", "LD_LBFGS", "LD_MMA"])
def test_global_then_local_finds_the_deepest(name: str, local: str) -> None:
    found = fit(
        Problem(Wave(), [TARGET], PARAMETERS), FitOptions(algorithm=(name, local), max_evaluations=3000, seed=2)
    )
    assert found.best["k"] == pytest.approx(13.0, abs=0.01)
    assert found.best["a"] == pytest.approx(1.0, abs=0.01)
    assert found.settled
    low, high = found.intervals().loc["k", ["lower", "upper"]]
    assert low < 13.0 < high < low + 0.5


def test_many_starts_find_it_too() -> None:
    assert fit(Problem(Wave(), [TARGET], PARAMETERS), FitOptions(starts=24)).best["k"] == pytest.approx(13.0, abs=0.01)


def test_a_tie_moves_both_and_a_fixed_value_stays() -> None:
    tied = [Parameter("a", 0.5, 2.0, 1.2), Parameter("k", tied="a", factor=13.0)]
    found = fit(Problem(Wave(), [TARGET], tied), FitOptions(starts=8))
    assert found.best["k"] == pytest.approx(13.0 * found.best["a"], rel=1e-12)
    assert found.best["a"] == pytest.approx(1.0, abs=0.01)
    frame = found.intervals()
    assert frame.loc["k", "lower"] == pytest.approx(13.0 * frame.loc["a", "lower"])
    fixed = [Parameter("a", 0.5, 2.0, 1.1, fixed=True), Parameter("k", 12.0, 14.0, 12.7)]
    held = fit(Problem(Wave(), [TARGET], fixed))
    assert held.best["a"] == 1.1
    assert held.intervals().loc["a", "status"] == "fixed"
    assert np.isnan(held.intervals().loc["a", "lower"])


def test_a_prior_pulls_by_its_weight() -> None:
    # 41 points of σ 0.05 hold a to s; a prior of the same s half-way off pulls it half of the way.
    free = fit(Problem(Wave(), [TARGET], [Parameter("a", 0.5, 2.0, 1.2), Parameter("k", 13.0, 13.0)]))
    s = free.covariance.sd["a"]
    known = [Parameter("a", 0.5, 2.0, 1.2, prior_mean=1.0 + 4 * s, prior_sd=s), Parameter("k", 13.0, 13.0)]
    pulled = fit(Problem(Wave(), [TARGET], known))
    assert pulled.best["a"] == pytest.approx(1.0 + 2 * s, abs=0.05 * s)
    assert pulled.covariance.sd["a"] == pytest.approx(s / np.sqrt(2), rel=0.02)


def test_a_flat_objective_is_told() -> None:
    nothing = CurveTarget("flat", ALL, np.full(41, 2.0), np.full(41, 0.05), "none", "chi2")

    class Flat(Wave):
        def curve(self, values: Mapping[str, float]) -> tuple[Any, Any, dict[str, Any]]:
            return np.full(41, 2.0), np.zeros(41), {"a": np.zeros(41), "k": np.zeros(41)}

    found = fit(Problem(Flat(), [nothing], PARAMETERS))
    assert found.verdict.verdict == "not held"
    assert set(found.verdict.alone) == {"a", "k"}
    assert sum("does not depend on it" in note for note in found.notes) == 2, found.notes
    assert list(found.intervals()["open"]) == ["both", "both"]


def test_one_point_cannot_hold_two_parameters_and_it_is_said() -> None:
    one = np.arange(41) == 20
    found = fit(Problem(Wave(), [CurveTarget("point", one, TARGET.data, TARGET.sigma, "none", "chi2")], PARAMETERS))
    assert any("2 parameters are free and 1 independent numbers are compared" in note for note in found.notes)
    assert found.verdict.verdict != "held"


def test_an_objective_that_is_nan_everywhere_is_an_error() -> None:
    class Nan(Wave):
        def curve(self, values: Mapping[str, float]) -> tuple[Any, Any, dict[str, Any]]:
            none = np.full(41, np.nan)
            return none, none, {"a": none, "k": none}

    with pytest.raises(InputError, match="finite"):
        fit(Problem(Nan(), [TARGET], PARAMETERS))
