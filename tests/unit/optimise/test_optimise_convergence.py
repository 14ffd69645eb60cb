"""The word "converged" is earned: NLopt's failures, noise, saddles, plateaus, bounds that are near and not met."""

from __future__ import annotations

import inspect
import math
from typing import Any

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.optimise import (
    OptimiseResult,
    Parameter,
    covariance,
    covariance_of_residuals,
    least_squares,
    minimise,
    profile,
)
from livlab.optimise.algorithms import ALGORITHMS
from livlab.optimise.jitter import chance_error, differenced_error

pytestmark = pytest.mark.filterwarnings("ignore::livlab.optimise.FitWarning")

X = np.linspace(0.0, 3.0, 40)
DECAY = [
    Parameter("a", 0.01, 50.0, 1.0, transform="log"),
    Parameter("k", 0.01, 50.0, 0.5, transform="log"),
    Parameter("c", -1.0, 1.0, 0.0),
]


class Decay:
    """Noisy data of a decay, and an objective that is noisy itself."""

    def __init__(self, seed: int, noise: float, *, exact: bool = True) -> None:
        self.rng, self.noise, self.exact = np.random.default_rng(seed), noise, exact
        a, k, c = self.rng.uniform((0.5, 0.3, -0.5), (5.0, 3.0, 0.5))
        self.y = a * np.exp(-k * X) + c + 0.02 * self.rng.standard_normal(40)

    def residuals(self, p: Any) -> Any:
        return (p["a"] * np.exp(-p["k"] * X) + p["c"] - self.y) / 0.02

    def __call__(self, p: Any) -> float:
        return 0.5 * float(np.sum(self.residuals(p) ** 2)) + self.noise * self.rng.standard_normal()

    def gradient(self, p: Any) -> dict[str, float]:
        fall, r = np.exp(-p["k"] * X), self.residuals(p) / 0.02
        made = {"a": r @ fall, "k": r @ (-X * p["a"] * fall), "c": r.sum()}
        if self.exact:
            return {n: float(v) for n, v in made.items()}
        return {n: float(v * (1 + 0.1 * self.rng.standard_normal())) for n, v in made.items()}

    def excess(self, found: OptimiseResult) -> float:
        """How far the true objective there lies above its least."""
        least = least_squares(self.residuals, DECAY, warn=False)
        return 0.5 * float(np.sum(self.residuals(found.best) ** 2)) - least.value


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("noise", [1e-6, 0.1, 1.0])
def test_noisy_fits_do_not_die_and_are_right_within_their_noise(noise: float, exact: bool) -> None:
    # 204 fits by LD_LBFGS, whose line search gives up on noise with nlopt.runtime_error.
    failed = wrong = 0
    for seed in range(34):
        decay = Decay(seed, noise, exact=exact)
        found = minimise(decay, DECAY, gradient=decay.gradient, algorithm="LD_LBFGS", warn=False)
        failed += "failed after" in found.stop
        wrong += bool(found) and decay.excess(found) > 6.0 * noise
        assert found.value <= found.path["value"].min() + 1e-12 * abs(found.value)
    assert failed > 0 or noise < 1e-3
    assert wrong == 0


@pytest.mark.parametrize("name", [n for n in ALGORITHMS if n not in ("LD_LBFGS", "GN_AGS")])
def test_no_algorithm_dies_of_noise(name: str) -> None:
    for seed in range(4):
        decay = Decay(seed, 0.1)
        slope = decay.gradient if name.startswith("LD_") else None
        found = minimise(decay, DECAY, gradient=slope, algorithm=name, warn=False, max_evaluations=1500)
        assert not found or decay.excess(found) < 1.0


def exceptions_of_nlopt() -> list[type[Exception]]:
    import nlopt

    module = inspect.getmodule(nlopt.opt)
    found = {o for m in (nlopt, module) for o in vars(m).values() if inspect.isclass(o) and issubclass(o, Exception)}
    return sorted(found, key=lambda o: o.__name__)


@pytest.mark.parametrize("kind", exceptions_of_nlopt())
def test_whatever_nlopt_raises_the_best_point_stays(kind: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    import nlopt

    made = kind.__new__(kind)  # Python cannot make all of them otherwise

    class Broken(nlopt.opt):  # type: ignore[misc]
        def optimize(self, x: Any) -> Any:
            super().set_maxeval(12)
            super().optimize(x)
            raise made

    monkeypatch.setattr(nlopt, "opt", Broken)
    found = minimise(lambda p: (p["x"] - 0.3) ** 2 + 1, [Parameter("x", 0, 1, 0.9)], algorithm="LN_BOBYQA", test=False)
    assert found.value == found.path["value"].min() < 1.36
    assert not found
    least = least_squares(lambda p: np.array([p["x"] - 0.3, 1.0]), [Parameter("x", 0, 1, 0.9)], algorithm="LN_BOBYQA")
    assert least.best["x"] == pytest.approx(0.3)
    assert least
    if kind.__name__ == "runtime_error":
        assert "LN_BOBYQA failed after" in found.stop
        assert "runtime_error" in least.stop


def test_an_error_of_the_callback_is_the_callers() -> None:
    def watch(count: int, _values: Any, _value: float) -> None:
        if count == 5:
            raise LookupError("my own")

    for name in ("LN_BOBYQA", "GN_CRS2_LM", "GN_DIRECT_L"):
        with pytest.raises(LookupError, match="my own"):
            minimise(lambda p: p["x"] ** 2, [Parameter("x", -1, 1, 0.4)], algorithm=name, callback=watch)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64, np.longdouble, np.int64, np.array])
@pytest.mark.parametrize("gradient", [False, True])
def test_objectives_of_numpys_types(kind: Any, gradient: bool) -> None:
    box = [Parameter("x", 0, 1, 0.9), Parameter("y", 0, 1, 0.1)]

    def slope(p: Any) -> dict[str, Any]:
        made = {"x": 200 * (p["x"] - 0.3), "y": 200 * (p["y"] - 0.6)}
        return {n: np.float32(v) for n, v in made.items()}

    found = minimise(
        lambda p: kind(100 * (p["x"] - 0.3) ** 2 + 100 * (p["y"] - 0.6) ** 2),
        box,
        gradient=slope if gradient else None,
        algorithm="LD_LBFGS" if gradient else "LN_BOBYQA",
    )
    # An integer is the same within a tenth of the box.
    assert found.best == pytest.approx({"x": 0.3, "y": 0.6}, abs=0.1 if kind is np.int64 else 1e-3)
    assert found


@pytest.mark.parametrize("kind", [np.float32, np.float16])
def test_residuals_of_few_digits(kind: Any) -> None:
    decay = Decay(3, 0.0)
    exact = least_squares(decay.residuals, DECAY)
    rough = least_squares(lambda p: decay.residuals(p).astype(kind), DECAY)
    assert exact
    assert rough
    assert list(rough.best.values()) == pytest.approx(
        list(exact.best.values()), rel=1e-5 if kind is np.float32 else 0.01
    )


def well(p: Any) -> float:
    return ((p["c"] - 3e-12) / 1e-12) ** 2


TINY = [(0.0, math.inf), (0.0, 1.0), (-1.0, 1.0), (0.0, 1e6), (-math.inf, math.inf)]


@pytest.mark.parametrize("bounds", TINY)
def test_a_tiny_optimum_is_not_at_its_bound(bounds: tuple[float, float]) -> None:
    box = [Parameter("c", *bounds, 1e-11)]
    slope = {"gradient": lambda p: {"c": 2 * (p["c"] - 3e-12) / 1e-24}}
    for found in (
        minimise(well, box, one_sigma=1.0),
        minimise(well, box, one_sigma=1.0, **slope),
        least_squares(lambda p: np.array([(p["c"] - 3e-12) / 1e-12]), box),
    ):
        assert found.best["c"] == pytest.approx(3e-12, rel=1e-3)
        assert found.status == {"c": "free"}
        assert found.warnings == ()
        assert found
    sure = covariance(well, box, found.best, one_sigma=1.0)
    assert sure.held == ()
    assert sure.sd["c"] == pytest.approx(1e-12, rel=1e-4)
    assert covariance_of_residuals({"c": np.array([1e12])}, box, found.best).sd["c"] == pytest.approx(1e-12)
    walked = profile(well, box, found.best, "c", one_sigma=1.0)
    assert (walked.lower, walked.upper) == pytest.approx((2e-12, 4e-12), rel=1e-3)
    assert not walked.open_below


def test_an_optimum_on_its_bound_is_at_it_exactly() -> None:
    box = [Parameter("c", 0.0, math.inf, 1e-11)]
    found = minimise(lambda p: ((p["c"] + 3e-12) / 1e-12) ** 2, box)
    assert found.best == {"c": 0.0}
    assert found.status == {"c": "at lower bound"}
    assert found
    # The box's end has digits that its unit rounds; the parameter has the box's.
    odd = [Parameter("c", 0.01, 0.1, 0.05), Parameter("d", 1 / 3, 2 / 3, 0.5, transform="log")]
    found = minimise(lambda p: -p["c"] - p["d"], odd)
    assert found.best == {"c": 0.1, "d": 2 / 3}
    assert found
    assert covariance(lambda p: -p["c"] - p["d"], odd, found.best).held == ("c", "d")


@pytest.mark.parametrize("gradient", [False, True])
def test_a_saddle_is_left(gradient: bool) -> None:
    box = [Parameter("x", -1, 1, 0.0), Parameter("y", -1, 2, 0.0)]
    slope = {"gradient": lambda p: {"x": 2 * p["x"], "y": -2 * p["y"] + 4 * p["y"] ** 3}} if gradient else {}
    found = minimise(lambda p: 3 + p["x"] ** 2 - p["y"] ** 2 + p["y"] ** 4, box, algorithm="auto", **slope)
    assert found.value == pytest.approx(2.75)
    assert abs(found.best["y"]) == pytest.approx(0.5**0.5, abs=1e-3)
    assert found
    # Two equal decays are a saddle of a sum of two different ones.
    y = np.exp(-X) + np.exp(-3 * X)
    twins = [Parameter("a", 0, 10, 1.5), Parameter("b", 0, 10, 1.5)]
    apart = least_squares(lambda p: np.exp(-p["a"] * X) + np.exp(-p["b"] * X) - y, twins)
    assert sorted(apart.best.values()) == pytest.approx([1.0, 3.0])
    assert apart


def test_a_plateau_is_no_minimum() -> None:
    box = [Parameter("x", 0, 1, 0.9)]
    found = minimise(lambda p: max(p["x"], 0.5), box, algorithm="LN_BOBYQA", max_evaluations=300)
    assert found.value == 0.5
    flat = minimise(lambda p: 1.0 if p["x"] > 0.2 else p["x"], box, algorithm="LN_BOBYQA")
    assert not flat
    assert "not converged" in flat.stop
    # A rate that ran out to where nothing depends on it any more.
    y = 2 * (1 - np.exp(-0.5 * X)) + 0.01
    rise = [Parameter("a", start=1.0), Parameter("k", 0.0, start=1e4)]

    def residuals(p: Any) -> Any:
        return p["a"] * (1 - np.exp(-p["k"] * X)) - y

    lost = least_squares(residuals, rise)
    assert lost.best["k"] == pytest.approx(0.5, rel=0.1)
    assert lost
    assert not least_squares(residuals, rise, max_evaluations=6)


def test_a_kink_is_a_minimum() -> None:
    found = minimise(
        lambda p: abs(p["x"] - 0.3) + 3 * abs(p["y"] + 0.2) + 1,
        [Parameter("x", -1, 1, 0.9), Parameter("y", -1, 1, 0.5)],
        algorithm="LN_SBPLX",
    )
    assert found.best == pytest.approx({"x": 0.3, "y": -0.2}, abs=1e-6)
    assert found


def rosenbrock(p: Any) -> float:
    return 100 * (p["b"] - p["a"] ** 2) ** 2 + (1 - p["a"]) ** 2


VALLEY = [Parameter("a", -2, 2, -1.2), Parameter("b", -1, 3, 0.7)]


@pytest.mark.parametrize("options", [{"value_tolerance": 0.1}, {"parameter_tolerance": 0.1}, {"max_evaluations": 30}])
def test_an_early_end_is_not_called_converged_or_is_gone_on_from(options: dict[str, Any]) -> None:
    found = minimise(rosenbrock, VALLEY, algorithm="LN_BOBYQA", **options)
    assert not found or found.value < 1e-8
    if not found:
        assert "stopped, not converged" in found.stop or found.evaluations == 30
        assert any("stopped, not converged" in sentence for sentence in found.warnings)
        assert "no: " in found.summary()


def test_without_the_test_nothing_is_called_converged() -> None:
    found = minimise(rosenbrock, VALLEY, algorithm="LN_BOBYQA", test=False)
    assert found.value < 1e-8
    assert not found
    assert found.convergence.words == "the end was not tested"


def test_a_wrong_gradient_is_told() -> None:
    found = minimise(
        lambda p: (p["a"] - 1) ** 2 + (p["b"] - 1) ** 2,
        VALLEY,
        gradient=lambda p: {"a": 2 * (p["a"] + 0.5), "b": 2 * (p["b"] - 1)},
        max_evaluations=400,
    )
    assert not found
    assert "the gradient by a does not agree with the objective" in found.stop or found.evaluations == 400


def test_what_was_polished_is_said() -> None:
    decay = Decay(5, 0.0)
    found = least_squares(decay.residuals, DECAY, value_tolerance=1e-3)
    assert found.polish is not None
    assert found.polish.after < found.polish.before
    assert f"polished by Levenberg–Marquardt from {found.polish.before:.8g} to {found.value:.8g}" in found.stop
    assert found.to_dict()["polish"] == str(found.polish)
    assert minimise(rosenbrock, VALLEY).polish is None
    # A Jacobian by names may leave out what changes nothing; ties move with theirs.
    tied = [Parameter("a", 0, 10, 1.0), Parameter("b", tied="a", factor=2.0), Parameter("idle", 0, 1, 0.5)]
    both = least_squares(
        lambda p: np.array([p["a"] + p["b"] - 6.0, 0.1]), tied, jacobian=lambda p: dict.fromkeys("ab", np.array([1, 0]))
    )
    assert both.best == pytest.approx({"a": 2.0, "b": 4.0, "idle": 0.5})
    assert both


def test_a_start_on_a_bound_is_left() -> None:
    decay = Decay(2, 0.0)
    free = least_squares(decay.residuals, DECAY)
    for ends in ((0, 0, 0), (1, 1, 1), (0, 1, 0)):
        box = [
            Parameter(p.name, p.low, p.high, (p.low, p.high)[end], transform=p.transform)
            for p, end in zip(DECAY, ends, strict=True)
        ]
        found = least_squares(decay.residuals, box)
        assert found.value == pytest.approx(free.value, rel=1e-9)
        assert found


def test_residuals_that_fail_here_and_there_are_gone_round() -> None:
    decay = Decay(4, 0.0)

    def torn(p: Any) -> Any:
        if 0.7 < p["k"] < 0.75:
            raise ArithmeticError("a hole")
        r = decay.residuals(p)
        return np.where(p["c"] < -0.9, np.nan, r)

    found = least_squares(torn, DECAY)
    assert found.value == pytest.approx(least_squares(decay.residuals, DECAY).value, rel=1e-6)
    with pytest.raises(InputError, match="no finite value"):
        least_squares(lambda p: np.full(3, np.nan), DECAY, max_evaluations=80)


def test_the_same_buffer_may_be_given_back_each_time() -> None:
    buffer, decay = np.zeros(40), Decay(6, 0.0)

    def residuals(p: Any) -> Any:
        buffer[:] = decay.residuals(p)
        return buffer

    assert least_squares(residuals, DECAY).value == least_squares(decay.residuals, DECAY).value


def test_errors_of_values_are_measured() -> None:
    low, high, sizes = np.full(2, -np.inf), np.full(2, np.inf), np.ones(2)
    at = np.array([0.3, 0.7])
    rng = np.random.default_rng(2)

    def smooth(x: Any) -> float:
        return 5.0 + math.sin(3 * x[0]) * math.exp(x[1])

    assert chance_error(smooth, at, low, high, sizes) < 1e-14
    for sd in (1e-9, 1e-4, 0.3):
        found = [
            chance_error(lambda x, sd=sd: smooth(x) + sd * rng.standard_normal(), at, low, high, sizes)
            for _ in range(30)
        ]
        assert np.median(found) == pytest.approx(sd, rel=0.4)
    single = chance_error(lambda x: np.float32(smooth(x)), at, low, high, sizes)
    assert 1e-8 < single < 1e-6
    assert math.isnan(chance_error(lambda x: math.nan, at, low, high, sizes))
    assert differenced_error([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0]) > 0
