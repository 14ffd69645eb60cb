import math

import numpy as np
import pytest
from scipy import optimize

from livlab.errors import InputError, Interrupted
from livlab.optimise import FitWarning, Parameter, least_squares, minimise

pytestmark = pytest.mark.filterwarnings("ignore::livlab.optimise.FitWarning")

ROSEN = [Parameter("a", -2, 2, -1.2), Parameter("b", -1, 3, 0.7)]
DERIVATIVE_FREE = ["GN_CRS2_LM", "GN_DIRECT_L", "G_MLSL_LDS", "LN_BOBYQA", "LN_SBPLX"]


def rosenbrock(p):
    return 100 * (p["b"] - p["a"] ** 2) ** 2 + (1 - p["a"]) ** 2


def rosenbrock_slope(p):
    return {
        "a": -400 * p["a"] * (p["b"] - p["a"] ** 2) - 2 * (1 - p["a"]),
        "b": 200 * (p["b"] - p["a"] ** 2),
    }


def branin(p):
    x, y = p["x"], p["y"]
    valley = y - 5.1 / (4 * math.pi**2) * x**2 + 5 / math.pi * x - 6
    return valley**2 + 10 * (1 - 1 / (8 * math.pi)) * math.cos(x) + 10


BRANIN = [Parameter("x", -5, 10, 0.0), Parameter("y", 0, 15, 10.0)]
BRANIN_MINIMUM = 10 / (8 * math.pi)


@pytest.mark.parametrize("name", ["auto", *DERIVATIVE_FREE])
def test_rosenbrock_without_gradient(name):
    found = minimise(rosenbrock, ROSEN, algorithm=name, max_evaluations=4000)
    assert found.best == pytest.approx({"a": 1, "b": 1}, abs=1e-3)
    assert found.evaluations == len(found.path) <= 4000


@pytest.mark.parametrize("name", ["auto", "LD_SLSQP", "LD_LBFGS", "LD_MMA"])
def test_rosenbrock_with_gradient(name):
    found = minimise(rosenbrock, ROSEN, gradient=rosenbrock_slope, algorithm=name, max_evaluations=6000)
    # MMA creeps along the curved valley; the quasi-Newton methods do not.
    assert found.best == pytest.approx({"a": 1, "b": 1}, abs=1e-3 if name == "LD_MMA" else 1e-6)
    assert name == "LD_MMA" or found.evaluations < 200


@pytest.mark.parametrize("name", ["GN_ISRES", "GN_AGS"])
def test_slow_global_methods_come_near(name):
    found = minimise(branin, BRANIN, algorithm=(name, "LN_BOBYQA"), max_evaluations=1500)
    assert found.value == pytest.approx(BRANIN_MINIMUM, abs=1e-8)
    assert found.algorithm == f"{name} + LN_BOBYQA"


def test_as_low_as_scipy_on_the_same_problems():
    for f, box, x0 in ((rosenbrock, ROSEN, [-1.2, 0.7]), (branin, BRANIN, [0.0, 10.0])):
        names, bounds = [p.name for p in box], [(p.low, p.high) for p in box]

        def bare(x, f=f, names=names):
            return f(dict(zip(names, x, strict=True)))

        theirs = min(
            optimize.minimize(bare, x0, bounds=bounds, method="L-BFGS-B").fun,
            optimize.differential_evolution(bare, bounds, rng=1).fun,
        )
        assert minimise(f, box).value <= theirs + 1e-9


def test_least_squares_as_scipy_does():
    x = np.linspace(0, 3, 60)
    y = 2 * np.exp(-1.7 * x) + 0.3 + 0.02 * np.random.default_rng(4).standard_normal(60)
    start = {"a": 1.0, "k": 0.5, "c": 0.0}

    def residuals(p):
        return p["a"] * np.exp(-p["k"] * x) + p["c"] - y

    box = [
        Parameter("a", 0.01, 50, start["a"], "log"),
        Parameter("k", 0.01, 50, start["k"], "log"),
        Parameter("c", -1, 1, start["c"]),
    ]
    theirs = optimize.least_squares(lambda v: residuals(dict(zip(start, v, strict=True))), list(start.values()))
    ours = least_squares(residuals, box)
    assert list(ours.best.values()) == pytest.approx(list(theirs.x), rel=1e-5)
    assert ours.value == pytest.approx(theirs.cost, rel=1e-10)
    assert bool(ours)


def test_sphere_in_log_space_over_twelve_decades():
    box = [Parameter(n, 1e-9, 1e3, 1.0, transform="log") for n in ("p", "q")]
    found = minimise(
        lambda v: math.log10(v["p"] / 3e-7) ** 2 + math.log10(v["q"] / 40) ** 2, box, algorithm="LN_BOBYQA"
    )
    assert found.best == pytest.approx({"p": 3e-7, "q": 40.0}, rel=1e-5)
    linear = [Parameter(n, 1e-9, 1e3, 1.0) for n in ("p", "q")]
    worse = minimise(
        lambda v: math.log10(v["p"] / 3e-7) ** 2 + math.log10(v["q"] / 40) ** 2, linear, algorithm="LN_BOBYQA"
    )
    assert worse.value > found.value


def test_noisy_objective_is_found_within_its_noise():
    rng = np.random.default_rng(3)
    found = minimise(
        lambda p: (p["a"] - 0.3) ** 2 + (p["b"] + 0.4) ** 2 + 1e-3 * rng.standard_normal(),
        [Parameter("a", -1, 1, 0.9), Parameter("b", -1, 1, 0.9)],
        max_evaluations=400,
    )
    assert found.best == pytest.approx({"a": 0.3, "b": -0.4}, abs=0.1)


def test_islands_of_nan_and_steps_are_crossed():
    def f(p):
        x, y = p["x"], p["y"]
        if 0.2 < x < 0.5 and y < 0.8:
            return math.nan
        if x > 0.9:
            raise RuntimeError("the simulation failed")
        return abs(x - 0.6) + abs(y - 0.25) + 0.2 * math.floor(4 * y)

    found = minimise(f, [Parameter("x", 0, 1, 0.1), Parameter("y", 0, 1, 0.9)], algorithm=("GN_CRS2_LM", "LN_SBPLX"))
    assert found.best == pytest.approx({"x": 0.6, "y": 0.25}, abs=0.02) or found.value <= 0.0 + 0.26
    assert found.failures > 0
    assert np.isinf(found.path["value"]).sum() == found.failures
    assert any("failed" in sentence and "simulation" in sentence for sentence in found.warnings)


def test_a_start_that_fails_is_left_for_one_that_does_not():
    found = minimise(
        lambda p: math.inf if p["x"] < 0.5 else (p["x"] - 0.8) ** 2, [Parameter("x", 0, 1, 0.1)], algorithm="LN_BOBYQA"
    )
    assert found.best["x"] == pytest.approx(0.8, abs=1e-5)


def test_all_failing_is_an_error_that_says_so():
    with pytest.raises(InputError, match="no finite value in"):
        minimise(lambda p: math.nan, [Parameter("x", 0, 1)], max_evaluations=100)
    with pytest.raises(InputError, match="division by zero") as caught:
        minimise(lambda p: 1 / 0, [Parameter("x", 0, 1)], max_evaluations=100)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_flat_objective_warns():
    with pytest.warns(FitWarning, match="flat"):
        found = minimise(lambda p: 2.0, [Parameter("x", 0, 1)], max_evaluations=50)
    assert found.value == 2.0


def test_a_parameter_without_effect_is_named():
    found = minimise(
        lambda p: (p["x"] - 0.3) ** 2, [Parameter("x", 0, 1, 0.9), Parameter("idle", 0, 1, 0.5)], algorithm="LN_SBPLX"
    )
    moved = minimise(
        lambda p: (p["x"] - 0.3) ** 2,
        [Parameter("x", 0, 1, 0.9), Parameter("idle", 0, 1, 0.5)],
        gradient=lambda p: {"x": 2 * (p["x"] - 0.3)},
    )
    assert moved.status["idle"] == "unchanged from start"
    assert any("idle" in s and "does not depend" in s for s in moved.warnings)
    assert found.best["x"] == pytest.approx(0.3, abs=1e-5)


def test_an_optimum_on_a_bound_is_told():
    found = minimise(lambda p: p["x"] + (p["y"] - 0.5) ** 2, [Parameter("x", 0, 1), Parameter("y", 0, 1, 0.4)])
    assert found.status == {"x": "at lower bound", "y": "free"}
    assert any(s.startswith("x = 0 sits at lower bound") for s in found.warnings)


def test_nothing_free_is_evaluated_and_told():
    found = minimise(lambda p: p["x"] ** 2, [Parameter("x", 0, 5, 3.0, fixed=True)])
    assert (found.value, found.evaluations, found.status) == (9.0, 1, {"x": "fixed"})
    assert any("no parameter is free" in s for s in found.warnings)


def test_limits_of_evaluations_and_time_hold():
    found = minimise(rosenbrock, ROSEN, max_evaluations=25)
    assert found.evaluations == 25
    assert not found
    assert "limit of evaluations" in found.stop

    def slow(p):
        import time

        time.sleep(0.01)
        return rosenbrock(p)

    found = minimise(slow, ROSEN, max_seconds=0.15)
    assert found.seconds < 1.0
    assert "time" in found.stop


def test_ctrl_c_keeps_the_best_so_far():
    calls = []

    def f(p):
        calls.append(p["a"])
        if len(calls) == 30:
            raise KeyboardInterrupt
        return rosenbrock(p)

    for name in ("LN_BOBYQA", "GN_CRS2_LM", "G_MLSL_LDS", "GN_DIRECT_L"):
        calls.clear()
        found = minimise(f, ROSEN, algorithm=name)
        assert found.interrupted
        assert len(calls) == 30
        assert found.value == found.path["value"].min()

    def at_once(p):
        raise KeyboardInterrupt

    with pytest.raises(Interrupted):
        minimise(at_once, ROSEN)


def test_the_callback_sees_each_call_and_can_stop():
    seen = []

    def watch(count, values, value):
        seen.append((count, values["a"], value))
        return count < 12

    found = minimise(rosenbrock, ROSEN, callback=watch)
    assert [s[0] for s in seen] == list(range(1, 13))
    assert "callback" in found.stop


def test_rounding_limited_counts_as_converged():
    # Steps of the size of rounding: BOBYQA and SLSQP give up with ROUNDOFF_LIMITED or a tolerance, never an exception.
    box = [Parameter("a", -1, 1, 0.4), Parameter("b", -1, 1, -0.2)]
    for name in ("LN_BOBYQA", "LD_SLSQP", "LD_LBFGS", "LD_MMA"):
        found = minimise(
            lambda p: 1e8 + (p["a"] - 0.1) ** 2 + (p["b"] - 0.1) ** 2,
            box,
            gradient=lambda p: {"a": 2 * (p["a"] - 0.1), "b": 2 * (p["b"] - 0.1)},
            algorithm=name,
            value_tolerance=0.0,
            parameter_tolerance=0.0,
            max_evaluations=2000,
        )
        assert math.isfinite(found.value)
        assert found.best == pytest.approx({"a": 0.1, "b": 0.1}, abs=1e-3)


def test_several_starts_leave_a_local_minimum():
    def f(p):
        return -3 * math.exp(-(((p["x"] - 0.8) / 0.05) ** 2)) - math.exp(-(((p["x"] - 0.2) / 0.1) ** 2))

    box = [Parameter("x", 0, 1, 0.25)]
    one = minimise(f, box, algorithm="LN_BOBYQA")
    many = minimise(f, box, algorithm="LN_BOBYQA", starts=16)
    assert many.value < one.value
    assert many.best["x"] == pytest.approx(0.8, abs=1e-4)
    assert len(many.starts) == 16
    assert many.starts["evaluations"].sum() == many.evaluations


def test_the_same_seed_gives_the_same_path():
    first, second = (minimise(branin, BRANIN, seed=5, max_evaluations=300).path["value"] for _ in range(2))
    other = minimise(branin, BRANIN, seed=6, max_evaluations=300).path["value"]
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


def test_starts_outside_the_bounds_are_moved_and_told():
    found = minimise(rosenbrock, ROSEN, starts=[{"a": -7.0, "b": 0.0}], algorithm="LN_BOBYQA")
    assert any("outside the bounds of a" in s for s in found.warnings)
    with pytest.raises(InputError, match="no parameters"):
        minimise(rosenbrock, ROSEN, starts=[{"c": 1.0}])


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("must be auto or of", {"algorithm": "LN_NONSENSE"}),
        ("needs the gradient", {"algorithm": "LD_MMA"}),
        ("Put the global first", {"algorithm": ("LN_BOBYQA", "GN_CRS2_LM")}),
        ("max_evaluations", {"max_evaluations": 0}),
        ("max_seconds", {"max_seconds": 0.0}),
        ("starts", {"starts": 0}),
        ("one_sigma", {"one_sigma": 0.0}),
    ],
)
def test_wrong_calls_say_what_to_do(words, options):
    with pytest.raises(InputError, match=words):
        minimise(rosenbrock, ROSEN, **options)


def test_global_search_needs_a_finite_box_and_few_enough_parameters():
    with pytest.raises(InputError, match="infinite"):
        minimise(lambda p: p["x"] ** 2, [Parameter("x")], algorithm="GN_CRS2_LM")
    assert minimise(lambda p: (p["x"] - 40) ** 2, [Parameter("x")]).best["x"] == pytest.approx(40)
    with pytest.raises(InputError, match="at most 10"):
        minimise(lambda p: sum(p.values()), [Parameter(f"x{k}", 0, 1) for k in range(11)], algorithm="GN_AGS")


def test_summary_and_plain_data():
    found = minimise(rosenbrock, ROSEN, max_evaluations=25)
    assert "limit of evaluations" in found.summary()
    assert found.to_frame().loc["a", "status"] == "free"
    assert found.to_dict()["best"] == found.best
