"""The end of a least-squares search polished by Levenberg–Marquardt, and tested before it is called converged."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from livlab.optimise.curvature import Curvature, curvature
from livlab.optimise.guard import Guard, Halt
from livlab.optimise.jitter import chance_error
from livlab.optimise.levenberg import FACTOR, STEPS, SearchEnd, SearchPoint, levenberg_marquardt, sum_of_squares
from livlab.optimise.parameters import ParameterSpace
from livlab.optimise.result import Convergence, Polish
from livlab.units import FloatArray

PROMISE = 1e-8
"""Share of Σ r² that Newton's step may still promise at an end that is called converged."""

SAME = 1e-9
"""Share of Σ r² within which two ends are equally low."""

WEAK = 1e-7
"""Share of the residuals by which a parameter must change them at its own size, or it is asked whether it does more
elsewhere."""

LEADS = 8
"""Points with a lost parameter put elsewhere from which a search is made, at most."""

GLANCE = 10
"""Steps from a further start that show whether it leads lower than a minimum on a bound."""

ZERO = 1e-16
"""Residuals over those of the start that count as zero."""

ESCAPES = 3
"""Times that a search goes on from a lower point beside an end that is a saddle, at most."""

REFINEMENTS = 12
"""Newton's steps that finish an end, at most."""

MOST = 20
"""Parameters up to which the residuals' own bend is measured."""

STRIDES = (0.1, 0.3, 1.0)
"""Steps tried along a direction that bends downwards, where 1 is about the size that would double Σ r²."""


class Residual(Protocol):
    """Residuals of named parameters, as `livlab.optimise.residuals.ResidualProblem`."""

    space: ParameterSpace

    def at(self, values: Mapping[str, float]) -> FloatArray:
        """(m,) residuals, at no cost if these are the last values asked for."""

    def vector(self, x: FloatArray) -> FloatArray:
        """(m,) residuals at x; nan where there are none."""

    def matrix(self, x: FloatArray) -> FloatArray:
        """(m, n) their derivatives by x."""

    def exact_matrix(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`matrix` with the best steps there are, and the lengths of its columns' errors."""

    def fine_matrix(self, x: FloatArray) -> FloatArray:
        """`matrix` with those steps."""


@dataclass(frozen=True, eq=False)
class _Ended:
    """An end, where its search came from, and the verdict on it."""

    origin: str
    end: SearchEnd
    verdict: Convergence


@dataclass(eq=False)
class Polisher:
    """Levenberg–Marquardt on the residuals and priors behind the guard, in the box.

    Attributes
    ----------
    guard, problem
        What counts and keeps, and the residuals.
    first
        The objective at the search's start.
    """

    guard: Guard
    problem: Residual
    first: float

    def __post_init__(self) -> None:
        self.space = self.guard.space
        self.box = (self.space.low, self.space.high)
        self.shape = 0
        self.leads: list[FloatArray] = []
        # Below both the digits of residuals such as the start's and anything that a likelihood could tell.
        self.zero = min(2.0 * ZERO**2 * self.first, ZERO * self.guard.prior_scale)

    def run(self, start: FloatArray | None, spare: Sequence[FloatArray]) -> tuple[Polish | None, Convergence]:
        """Polish the guard's best point, and tell whether the end is a minimum.

        Parameters
        ----------
        start
            Where the search began: it is polished, too, and counts if it leads lower or as low.
        spare
            Further starts, tried if the end is no minimum or lies on a bound.
        """
        before, count = self.guard.best, self.guard.count
        best: _Ended | None = None
        try:
            for found in self.attempts(start, spare):
                best = found
        except Halt:
            words = self.guard.reason or "the search had to end"
            if best is None:
                return None, Convergence(False, words)
            best = replace(best, verdict=Convergence(False, words))
        assert best is not None
        if self.guard.reason is None:
            self.guard.settle(best.end.point.x, 0.5 * best.end.point.cost)
        used = self.guard.count - count
        return Polish(best.origin, before, self.guard.best, best.end.steps, used), best.verdict

    def attempts(self, start: FloatArray | None, spare: Sequence[FloatArray]) -> Iterator[_Ended]:
        """The best end so far, after each attempt; the last one is to be had."""
        assert self.guard.best_x is not None
        origin, end = "the search's end", self.search(self.guard.best_x)
        yield _Ended(origin, end, Convergence(False, "the end was not tested"))
        if start is not None:
            other, noise = self.search(start), self.noise(end.point.x)
            if other.point.cost <= end.point.cost * (1.0 + SAME) + 6.0 * _noise_of_half(end.point.r, noise):
                origin, end = "the start", other
        best = _Ended(origin, *self.finish(end))
        yield best
        if best.verdict and not self.on_bound(best.end.point.x):
            return
        # Steps that begin small stay in the start's own valley.
        others = [] if start is None or not spare else [("the start", start, 1.0), ("the start", start, 0.1)]
        others += [("another start", x, FACTOR) for x in (*self.leads[:LEADS], *spare)]
        for origin, x, factor in others:
            # Beside an end that is a minimum, another valley is only looked into.
            other = self.search(x, factor, GLANCE if best.verdict else STEPS)
            if other.point.cost < best.end.point.cost * (1.0 - SAME):
                other = self.search(other.point.x) if other.steps >= GLANCE else other
                best = _Ended(origin, *self.finish(other))
                yield best

    def on_bound(self, x: FloatArray) -> bool:
        """Whether any parameter lies on a bound: what lies behind a bound can make valleys of its own."""
        return bool(((x <= self.box[0]) | (x >= self.box[1])).any())

    def search(self, x: FloatArray, factor: float = FACTOR, steps: int = STEPS) -> SearchEnd:
        """Levenberg–Marquardt from x."""
        sizes = self.space.sizes(x)
        return levenberg_marquardt(
            self.residuals, self.matrix, x, self.box, sizes, factor=factor, zero=self.zero, steps=steps
        )

    def residuals(self, x: FloatArray) -> FloatArray:
        """Residuals and priors at x, counted and kept by the guard; nan where it failed."""
        value = self.guard.spend(x)
        if not math.isfinite(value):
            return np.full(max(self.shape, 1), np.nan)
        priors = self.space.prior_residuals(x, self.guard.prior_scale)
        r = np.concatenate([self.problem.at(self.space.values(x)), priors])
        self.shape = r.size
        return r

    def matrix(self, x: FloatArray) -> FloatArray:
        """Their derivatives."""
        return np.concatenate([self.problem.matrix(x), self._priors(x)])

    def _priors(self, x: FloatArray) -> FloatArray:
        return self.space.prior_columns(x, self.guard.prior_scale)

    def finish(self, end: SearchEnd) -> tuple[SearchEnd, Convergence]:
        """The end led to the very lowest point by Newton's steps, away from saddles, and the verdict on it."""
        for number in range(ESCAPES + 1):
            x, r = end.point.x, end.point.r
            noise = self.noise(x)
            exact, errors = self.problem.exact_matrix(x)
            matrix = np.concatenate([exact, self._priors(x)])
            if not (np.isfinite(matrix).all() and np.isfinite(r).all()):
                return end, Convergence(False, "the residuals have no derivatives there")
            linear = x.size > MOST or sum_of_squares(r) <= 1e4 * r.size * noise**2
            here, sizes = SearchPoint(x, r, matrix), self.space.sizes(x)
            about = curvature(here, errors, end.lengths, sizes, self.box, None if linear else self.matrix)
            lower = self.escape(about, x, sum_of_squares(r)) if number < ESCAPES else None
            if lower is None:
                break
            end = self.search(lower)
        last = self.refine(about, here, noise)
        return SearchEnd(last, end.steps, end.lengths), self.verdict(about, last, errors, noise)

    def noise(self, x: FloatArray) -> float:
        """Root mean square of the residuals' errors by chance or rounding."""
        found = chance_error(self.problem.vector, x, *self.box, self.space.sizes(x))
        return found if math.isfinite(found) else 0.0

    def escape(self, about: Curvature, x: FloatArray, cost: float) -> FloatArray | None:
        """A lower point along a direction in which Σ r² does not bend upwards, if there is one."""
        for way in about.down.T:
            for stride in STRIDES:
                for sign in (1.0, -1.0):
                    there: FloatArray = np.clip(x + sign * stride * way, *self.box)
                    r = self.residuals(there)
                    if np.isfinite(r).all() and sum_of_squares(r) < cost * (1.0 - 1e-9):
                        return there
        return None

    def refine(self, about: Curvature, end: SearchPoint, noise: float) -> SearchPoint:
        """Newton's steps for as long as they shrink: they find the lowest point where values only show rounding."""
        last = math.inf
        for _ in range(REFINEMENTS):
            if about.axes.shape[1] == 0 or end.cost <= self.zero:
                break
            step, promised = about.newton(end)
            there = np.clip(end.x + step, *self.box)
            if not promised < 0.5 * last or np.array_equal(there, end.x):
                break
            r = self.residuals(there)
            most = end.cost * (1.0 + SAME) + 6.0 * _noise_of_half(end.r, noise)
            if not np.isfinite(r).all() or sum_of_squares(r) > most:
                break
            matrix = np.concatenate([self.problem.fine_matrix(there), self._priors(there)])
            if not np.isfinite(matrix).all():
                break
            end, last = SearchPoint(there, r, matrix), promised
        return end

    def lost(self, about: Curvature, end: SearchPoint) -> list[str]:
        """Parameters that do nothing there, though they do elsewhere; points from where a search may fare better."""
        own, (low, high), found = np.linalg.norm(end.matrix, axis=0), self.box, []
        width = np.where(np.isfinite(high - low), 1e-3 * (high - low), 1.0)
        room = np.maximum(np.maximum(self.space.sizes(end.x), np.abs(end.x - self.space.start)), width)
        weak = (own * room <= WEAK * math.sqrt(end.cost)) & (end.x > low) & (end.x < high)
        for k in np.flatnonzero(weak | about.lost):
            others = [(self.problem.vector(x), x) for x in self.space.elsewhere(end.x, int(k))]
            m = end.r.size - self.space.prior_residuals(end.x, 1.0).size
            moved = [x for r, x in others if np.isfinite(r).all() and _far(r, end.r[:m], math.sqrt(WEAK * end.cost))]
            if moved or about.lost[k]:
                self.leads += moved
                found.append(self.space.names[k])
        return found

    def verdict(self, about: Curvature, end: SearchPoint, errors: FloatArray, noise: float) -> Convergence:
        """Whether the end is a minimum: what Newton's step promises, beside the derivatives' own errors."""
        r, matrix, cost = end.r, end.matrix, end.cost
        half_noise = _noise_of_half(r, noise)
        lost = self.lost(about, end)
        if lost:
            words = f"the residuals do not depend on {', '.join(lost)} there, though elsewhere they do"
            return Convergence(False, words, 0.0, half_noise)
        if cost > self.zero and not end.matrix.any():
            return Convergence(False, "the residuals are flat there", 0.0, half_noise, flat=True)
        if cost <= self.zero or about.axes.shape[1] == 0:
            words = (
                "the residuals are zero" if cost <= self.zero else "every parameter that matters is held by its bound"
            )
            return Convergence(True, words, 0.0, half_noise)
        _, promised = about.newton(end)
        # What errors of the derivatives and of the residuals alone would promise.
        hidden = about.hidden(end, errors * math.sqrt(cost) + noise * np.linalg.norm(matrix, axis=0))
        decrease = 0.5 * promised * cost
        if about.down.shape[1]:
            return Convergence(False, "Σ r² bends downwards there: a saddle, no minimum", decrease, half_noise)
        if promised <= PROMISE:
            return Convergence(True, f"the slope promises {promised:.1g} of Σ r² at most", decrease, half_noise)
        if cost <= 25.0 * r.size * noise**2:
            return Convergence(True, "the residuals are no larger than their own errors", decrease, half_noise)
        if decrease <= 0.1 * half_noise or (promised <= 9.0 * hidden and hidden <= 0.01):
            words = f"the slope promises {promised:.1g} of Σ r², no more than errors of the residuals make of it"
            return Convergence(True, words, decrease, half_noise)
        return Convergence(False, f"the slope still promises {promised:.2g} of Σ r²", decrease, half_noise)


def _far(r: FloatArray, other: FloatArray, least: float) -> bool:
    return r.size == other.size and float(np.abs(r - other).max()) > least


def _noise_of_half(r: FloatArray, noise: float) -> float:
    """Standard deviation of ½ Σ r² by errors of the residuals, and what they add to it."""
    return math.sqrt(sum_of_squares(r)) * noise + 0.5 * r.size * noise**2
