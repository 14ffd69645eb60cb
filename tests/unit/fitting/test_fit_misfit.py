"""A tissue model that misses its curves is told, one that fits is not, and the words say by how much and where."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fit_forwards import SMOOTH, Walked
from scipy.stats import f as fisher
from tissue_formula import GRID, TRUTH, Formula, bands, curve

from livlab.fitting.fit import fit
from livlab.fitting.misfit import misfit_of
from livlab.fitting.options import FitOptions
from livlab.fitting.outcome import FitOutcome
from livlab.fitting.problem import Problem
from livlab.fitting.roughness import beyond_zero, noise_of, ratio_p, roughness
from livlab.fitting.targets import CurveTarget
from livlab.optimise import Parameter, ParameterSpace

ALL = np.ones(23, dtype=bool)
SPACE = ParameterSpace(
    [
        Parameter("blood", 0.01, 0.15, 0.05, "log"),
        Parameter("oxygenation", 0.0, 1.0, 0.5),
        Parameter("bile", 0.0, 2.0, 0.3),
        Parameter("radius", 2.0, 80.0, 15.0, "log"),
    ]
)


def made(clean: Any, seed: int, sd: float = 0.01, *, known: bool = True, **changes: Any) -> CurveTarget:
    sigma = sd * clean
    data = clean + sigma * np.random.default_rng(seed).standard_normal(23)
    changes = {"scaling": "none", "loss": "chi2" if known else "rmse", "label": "made", **changes}
    return CurveTarget(use=ALL, data=data, sigma=sigma if known else np.full(23, np.nan), wavelength_nm=GRID, **changes)


def fitted(*targets: CurveTarget, space: ParameterSpace = SPACE, forward: Any = None) -> FitOutcome:
    return fit(Problem(forward or Formula(), targets, space), FitOptions(most_recordings=2))


WITH_A_BAND = curve(TRUTH) * (1.0 - bands(GRID, (0.25, 630.0, 12.0)))


@pytest.mark.parametrize("scaling", ["none", "max", "sum", "free"])
def test_one_more_band_is_told_with_its_wavelength(scaling: Any) -> None:
    found = fitted(made(WITH_A_BAND, 1, scaling=scaling))
    assert found.settled
    assert not found
    assert found.misfit.p < 1e-10
    assert found.misfit.dof == 19 - (scaling != "none")
    assert any(f"near {x} nm" in found.misfit_words for x in (620, 625, 630, 635, 640))
    assert "hold only if the model is right" in found.misfit_words
    plain = fitted(made(curve(TRUTH), 1, scaling=scaling))
    assert plain
    assert plain.widened == 1.0
    assert "fits to the noise" in plain.misfit_words


def test_intervals_are_widened_by_what_is_said() -> None:
    # The same curve with errors stated so large that it fits: the interval grows with them, about as the widening does.
    found = fitted(made(WITH_A_BAND, 1))
    assert found.widened >= found.misfit.ratio > 4.0
    assert found.residual_scale == pytest.approx(found.widened**2)
    assert f"widened by {found.widened:.2g} x" in found.misfit_words
    target = made(WITH_A_BAND, 1)
    wide = fitted(replace(target, sigma=found.widened * target.sigma))
    assert wide.widened == 1.0
    one, other = found.intervals(), wide.intervals()
    for name in ("blood", "oxygenation"):
        assert one.loc[name, ["lower", "upper"]].to_numpy(float) == pytest.approx(
            other.loc[name, ["lower", "upper"]].to_numpy(float), rel=0.05
        )


def test_without_stated_errors_the_neighbours_tell() -> None:
    found = fitted(made(WITH_A_BAND, 2, 1e-3, known=False))
    assert not found
    assert found.misfit.ratio > 2.0
    assert "the noise is estimated from how neighbouring points differ" in found.misfit_words
    assert "the intervals take all of the residual for noise" in found.misfit_words
    assert found.widened == 1.0
    assert fitted(made(curve(TRUTH), 2, 1e-3, known=False))


def test_a_small_but_smooth_residual_is_a_misfit_whatever_its_size() -> None:
    # Pearson is .9999 here and the RMSE 2e-3 of the curve; noise of 2e-4 leaves no doubt.
    clean = curve(TRUTH) * (1.0 + bands(GRID, (0.006, 610.0, 40.0)))
    narrow = ParameterSpace([p for p in SPACE.parameters if p.name in ("blood", "oxygenation")])
    found = fitted(made(clean, 3, 2e-4, known=False), space=narrow, forward=Formula(("blood", "oxygenation")))
    assert not found


def test_where_nothing_can_be_said_that_is_said() -> None:
    few = np.zeros(23, dtype=bool)
    few[::4] = True
    found = fitted(replace(made(WITH_A_BAND, 1, known=False), use=few))
    assert "no standard errors and too few points to estimate the noise" in found.misfit_words
    assert found.misfit.adequate is None
    assert bool(found) == found.settled
    few[8:] = False
    found = fitted(replace(made(WITH_A_BAND, 1), use=few))
    assert "no more numbers than free parameters" in found.misfit_words


def test_two_curves_are_judged_together_and_the_worse_is_named() -> None:
    good, bad = made(curve(TRUTH), 1, label="left"), made(WITH_A_BAND, 2, label="right")
    found = fitted(good, bad)
    assert not found
    assert found.misfit.dof == 46 - 4
    assert "of right" in found.misfit.where
    mixed = fitted(replace(good, sigma=np.full(23, np.nan), loss="rmse"), bad)
    assert mixed.misfit.dof == 42
    assert mixed.widened == 1.0


def test_a_prior_that_the_curve_contradicts_counts() -> None:
    prior = ParameterSpace([Parameter("oxygenation", 0.0, 1.0, 0.5, prior_mean=0.2, prior_sd=0.02)])
    found = fitted(made(curve(TRUTH), 1), space=prior, forward=Formula(("oxygenation",)))
    assert found.misfit.dof == 23
    assert found.misfit.p < 1e-10


def test_a_value_at_its_bound_has_no_sd_and_others_are_conditional() -> None:
    tight = ParameterSpace([replace(p, high=12.0, start=8.0) if p.name == "radius" else p for p in SPACE.parameters])
    frame = fitted(made(curve(TRUTH), 1, 0.03), space=tight).intervals()
    assert frame.loc["radius", "sd_note"] == "at a bound"
    wide = fitted(made(curve(TRUTH), 1, 0.003)).intervals()
    assert (wide["sd_note"] == "").all()


def test_the_walks_errors_are_noise() -> None:
    # Errors of a walk that hang together, four times the data's own; kept secret they pass for a misfit.
    x = np.linspace(0.0, 2.0, 21)
    space = ParameterSpace(
        [Parameter("a", 0.5, 3.0, 1.5), Parameter("k", 0.3, 3.0, 1.0, "log"), Parameter("c", 0.0, 1.0, 0.0, fixed=True)]
    )
    rng = np.random.default_rng(4)

    def ps(told: float) -> list[float]:
        found = []
        for i in range(60):
            forward = Walked(sd=0.08, told=told)
            data = 1.5 * np.exp(-x) + 0.02 * rng.standard_normal(21)
            target = CurveTarget("made", np.ones(21, bool), data, np.full(21, 0.02), "none", "chi2")
            forward.record({}, seed=1000 + i)
            problem = Problem(forward, [target], space)
            at = {"a": 1.5, "k": 1.0, "c": 0.0}
            problem.freeze_errors(at)
            found.append(misfit_of(problem, at).p)
        return found

    honest, secret = np.array(ps(1.0)), np.array(ps(0.0))
    assert 0.35 < honest.mean() < 0.65  # ± .037
    assert secret.mean() < 0.3
    assert SMOOTH[0, 1] > 0.9


def test_the_chance_of_a_quadratic_form_is_fishers() -> None:
    # P(χ²_a > t χ²_b): closed form by the F distribution.
    for a, b, t in ((6, 12, 2.5), (3, 15, 1.4), (10, 10, 0.3)):
        weights = np.concatenate([np.ones(a), np.full(b, -t)])
        assert beyond_zero(weights) == pytest.approx(fisher.sf(t * b / a, a, b), rel=0.03)
    assert beyond_zero(np.ones(3)) == 1.0
    assert beyond_zero(-np.ones(3)) == 0.0


def test_roughness_is_the_noise_on_any_grid_and_its_chance_is_even() -> None:
    rng = np.random.default_rng(8)
    x = np.sort(rng.uniform(500, 700, 30))
    rows = np.array([np.ones(30), x - 600.0])
    noise = rng.standard_normal((600, 30))
    rough = roughness(x)
    assert np.mean(np.einsum("sn,nm,sm->s", noise, rough, noise)) == pytest.approx(np.trace(rough), rel=0.03)
    ps = [ratio_p(z, rows, [(slice(0, 30), x)]) for z in noise]
    from scipy.stats import kstest

    assert kstest(ps, "uniform").pvalue > 0.01
    level = np.linspace(0.1, 1.0, 30)
    nothing = np.zeros((30, 30))
    alike = np.median([noise_of(0.1 * z, x, level, np.eye(30), nothing, 1e-12) for z in noise], axis=0)
    share = np.median([noise_of(0.1 * level * z, x, level, np.eye(30), nothing, 1e-12) for z in noise], axis=0)
    assert alike[[0, -1]] == pytest.approx([0.01, 0.01], rel=0.15)
    assert share[[0, -1]] == pytest.approx([1e-4, 1e-2], rel=0.15)
