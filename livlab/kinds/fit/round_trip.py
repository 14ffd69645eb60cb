"""Round trips of a fit: tissues drawn by chance, simulated with noise, fitted; how often the intervals hold the truth.

The simulated curves come from a walk with a seed of its own, whose errors are counted in the data's covariance, and get
the measurement's noise; the intervals tested are those that every fit reports.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from livlab.errors import InputError, LivlabError
from livlab.fitting.fit import fit
from livlab.fitting.intervals import ProfileInterval
from livlab.fitting.options import FitOptions
from livlab.fitting.outcome import FitOutcome
from livlab.fitting.problem import Forward, Problem
from livlab.fitting.targets import CurveTarget
from livlab.optimise import ParameterSpace
from livlab.units import FloatArray

TOGETHER = 0.95
"""Correlation beyond which two parameters are told as not held apart."""

DRAWS = 200
"""Draws of a tissue that holds together, at most."""

SEEDS = 100_000
"""Between the recordings of one tissue and those of the next."""


@dataclass(frozen=True, eq=False)
class Held:
    """What one fit says of one parameter whose truth is known.

    Attributes
    ----------
    parameter
        Its name.
    truth, value
        What it was, and what was found.
    interval
        That of the fit.
    normal
        Whether the interval that the covariance alone gives holds the truth; None at a bound, where there is none.
    width
        Of the interval, as a share of the (transformed) box.
    partner, correlation
        The parameter that it correlates with most, if beyond 0.95.
    """

    parameter: str
    truth: float
    value: float
    interval: ProfileInterval
    normal: bool | None
    width: float
    partner: str
    correlation: float

    @property
    def inside(self) -> bool:
        """Whether the interval holds the truth."""
        return self.interval.lower <= self.truth <= self.interval.upper

    @property
    def spans(self) -> bool:
        """Whether the interval says nothing: it reaches from bound to bound."""
        return self.interval.spans


@dataclass(frozen=True, eq=False)
class Trip:
    """One round trip: what was held, χ² at the truth and at the optimum, and how many numbers were compared."""

    held: tuple[Held, ...]
    chi2_truth: float
    chi2_best: float
    numbers: int
    settled: bool
    evaluations: int


def round_trip(
    forward: Forward,
    targets: Sequence[CurveTarget],
    space: ParameterSpace,
    options: FitOptions,
    *,
    relative_sd: float | None,
    rng: np.random.Generator,
    stopping: Callable[[], bool] | None = None,
) -> Trip:
    """Draw a tissue, simulate its curves with fresh draws and noise, fit them, and see what is held.

    Parameters
    ----------
    forward, targets, space
        As of `Problem`; the targets say band, scaling and weight, and what σ is as a share of the curve.
    options
        Of the fit; `seed` is that of its walks, 1000 apart, and the simulation's is far from them.
    relative_sd
        Noise as a share of the curve at each point; None: that of the targets' own σ.
    rng
        Draws tissue and noise.
    stopping
        As of `fit`.

    Raises
    ------
    InputError
        A loss without a likelihood, or bounds that hold no tissue.
    """
    for target in targets:
        if target.loss != "chi2":
            raise InputError.of(
                f"measurement {target.label}", target.loss, "says no likelihood, so that no interval can be tested",
                "Use loss = 'chi2' with a standard deviation for a round trip.",
            )  # fmt: skip
    truth = draw(forward, space, rng)
    forward.record(truth, (), seed=options.seed + SEEDS // 2)
    clean = forward.answer(truth)
    noise = getattr(forward, "noise_covariance", None)
    spread = np.array(noise(truth)) if noise is not None else np.diag(np.square(clean.standard_error))
    made = [_simulated(t, clean.value, spread, relative_sd, rng) for t in targets]
    found = fit(Problem(forward, made, space), options, stopping=stopping)
    return _judged(forward, made, found, truth)


def draw(forward: Forward, space: ParameterSpace, rng: np.random.Generator) -> dict[str, float]:
    """Values by chance: even between the bounds as the search sees them, from the prior where there is one.

    Raises
    ------
    InputError
        Bounds that are infinite, or that hold no tissue.
    """
    missing = space.finite_box()
    if missing:
        raise InputError.of("parameter", missing, "has no finite bounds to draw between", "Give both.")
    stack = getattr(forward, "stack", None)
    for _ in range(DRAWS):
        x = space.low + rng.random(len(space.free)) * (space.high - space.low)
        values = space.values(x)
        for p in space.free:
            if p.prior_mean is not None and p.prior_sd is not None:
                values[p.name] = min(max(rng.normal(p.prior_mean, p.prior_sd), p.low), p.high)
        values = space.values(space.vector(values))
        try:
            if stack is not None:
                stack(values)
        except LivlabError:
            continue
        return values
    raise InputError.of("parameter", space.names, "bounds hold hardly any tissue", "Narrow them.")


def _simulated(
    target: CurveTarget, curve: FloatArray, spread: FloatArray, relative_sd: float | None, rng: np.random.Generator
) -> CurveTarget:
    """The target with a simulated curve, its noise, and the errors of the walk that made it."""
    share = target.sigma / np.abs(target.data) if relative_sd is None else np.full_like(target.data, relative_sd)
    sigma = share * np.abs(curve)
    data = np.where(target.use, curve + np.where(target.use, sigma, 0.0) * rng.standard_normal(len(curve)), np.nan)
    return replace(target, data=data, sigma=sigma, covariance=spread)


def _judged(forward: Forward, targets: Sequence[CurveTarget], found: FitOutcome, truth: Mapping[str, float]) -> Trip:
    space = found.space
    normal = found.covariance.intervals(found.level)
    pairs = {name: (other, rho) for a, b, rho in found.verdict.pairs for name, other in ((a, b), (b, a))}
    held = []
    for p in space.free:
        interval = found.profiled[p.name]
        partner, rho = pairs.get(p.name, ("", 0.0))
        near = normal.loc[p.name] if p.name in normal.index else None
        held.append(
            Held(
                p.name,
                truth[p.name],
                found.best[p.name],
                interval,
                None if near is None else bool(near["lower"] <= truth[p.name] <= near["upper"]),
                (p.inward(interval.upper) - p.inward(interval.lower)) / (p.inward(p.high) - p.inward(p.low)),
                partner if abs(rho) > TOGETHER else "",
                float(rho) if abs(rho) > TOGETHER else 0.0,
            )
        )
    problem = Problem(forward, targets, space)
    problem.freeze_errors(found.best)
    best, there = problem.residuals(found.best), problem.residuals(truth)
    problem.release()
    evaluations = sum(s.evaluations for s in found.searches)
    return Trip(tuple(held), float(there @ there), float(best @ best), len(best), found.settled, evaluations)


__all__ = ["Held", "Trip", "draw", "round_trip"]
