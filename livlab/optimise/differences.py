"""Derivatives by differences, with steps that suit the function: what it rounds to, and how it bends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from livlab.units import FloatArray

LADDER = 10.0
"""Ratio of one step tried to the next."""

RUNGS = 12
"""Steps tried for a parameter above the first one, and below it, at most."""

FIRST = 1e-4
"""The first step tried, as a share of the parameter's size."""

GOOD = 1e-7
"""Disagreement of neighbouring steps, as a share of the derivative, at which a quick search need not look further."""

BEST = 3e-12
"""The same at which no search need look further."""

STALE = 30.0
"""Factor by which a parameter's size changes before its step is chosen anew."""

Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Slope:
    """A derivative along one parameter.

    Attributes
    ----------
    column
        (m,) the derivative.
    error
        How far two estimates of it disagree, as a length.
    step
        The larger one of the two steps that it is made of.
    """

    column: FloatArray
    error: float
    step: float


@dataclass
class Differences:
    """Derivatives of a function of x within a box, nan where the function gives no number.

    Attributes
    ----------
    function
        From (n,) x to (m,) numbers.
    low, high
        (n,) the box.
    steps, sizes
        (n,) steps that were found to suit, and how large the parameters were there.
    """

    function: Function
    low: FloatArray
    high: FloatArray
    steps: FloatArray = field(default_factory=lambda: np.zeros(0))
    sizes: FloatArray = field(default_factory=lambda: np.zeros(0))

    def tune(self, x: FloatArray, sizes: FloatArray, enough: float = BEST) -> tuple[FloatArray, FloatArray]:
        """(m, n) derivatives at x, and the (n,) lengths of their errors; others near by will take the same steps.

        Parameters
        ----------
        x, sizes
            (n,) where, and how large each parameter is there.
        enough
            Share of a derivative which its error may have, so that the search for a better step can end.
        """
        found = [self.slope(x, k, float(sizes[k]), enough) for k in range(x.size)]
        self.steps, self.sizes = np.array([s.step for s in found]), np.array(sizes)
        return np.array([s.column for s in found]).T, np.array([s.error for s in found])

    def matrix(self, x: FloatArray, sizes: FloatArray) -> FloatArray:
        """(m, n) derivatives at x by central differences of the smaller step, chosen anew where a size has changed."""
        if self.steps.size != x.size:
            return self.tune(x, sizes, GOOD)[0]
        columns = []
        for k, size in enumerate(sizes):
            if not 1.0 / STALE < size / self.sizes[k] < STALE:
                found = self.slope(x, k, float(size), GOOD)
                self.steps[k], self.sizes[k] = found.step, size
                columns.append(found.column)
            else:
                columns.append(self._difference(x, k, float(self.steps[k]) / LADDER))
        return np.array(columns).T

    def fine(self, x: FloatArray) -> FloatArray:
        """(m, n) derivatives at x, extrapolated from both steps; `tune` comes first."""
        pairs = [(float(h), k) for k, h in enumerate(self.steps)]
        return np.array(
            [_extrapolated(self._difference(x, k, h), self._difference(x, k, h / LADDER)) for h, k in pairs]
        ).T

    def slope(self, x: FloatArray, k: int, size: float, enough: float = BEST) -> Slope:
        """The derivative by parameter k, from those neighbouring steps whose estimates agree best.

        A large step errs since the function bends, a small one since it rounds or is noisy. The search goes up and down
        from the first step for as long as neighbours agree better.
        """
        simple: dict[int, FloatArray] = {}

        def step(rung: int) -> float:
            return FIRST * size * LADDER**rung

        def estimate(rung: int) -> FloatArray:
            for r in (rung, rung - 1):
                if r not in simple:
                    simple[r] = self._difference(x, k, step(r))
            return _extrapolated(simple[rung], simple[rung - 1])

        def apart(rung: int) -> float:
            with np.errstate(all="ignore"):
                off = float(np.linalg.norm(estimate(rung) - estimate(rung - 1)))
            return off if np.isfinite(off) else np.inf

        best, least = 0, apart(0)
        for way in (1, -1):
            worse = 0
            for rung in range(way, way * (RUNGS + 1), way):
                if worse > 1 or least <= enough * float(np.linalg.norm(estimate(best))):
                    break
                off = apart(rung)
                worse = 0 if off < least else worse + 1
                best, least = (rung, off) if off < least else (best, least)
        return Slope(estimate(best), least, step(best))

    def _difference(self, x: FloatArray, k: int, h: float) -> FloatArray:
        with np.errstate(all="ignore"):  # nan is an answer
            return self._quotient(x, k, h)

    def _quotient(self, x: FloatArray, k: int, h: float) -> FloatArray:
        """A central difference; beside a bound a one-sided one of the same order."""
        low, high = float(self.low[k]), float(self.high[k])
        if x[k] - h >= low and x[k] + h <= high:
            (a, below), (b, above) = (self._moved(x, k, x[k] + sign * h) for sign in (-1.0, 1.0))
            return np.asarray((above - below) / (b - a))
        up = high - x[k] >= x[k] - low
        h = min(h, 0.5 * (high - x[k])) if up else -min(h, 0.5 * (x[k] - low))
        here = self.function(x)
        (a, near), (b, far) = (self._moved(x, k, x[k] + share * h) for share in (1.0, 2.0))
        a, b = a - x[k], b - x[k]
        # Of the parabola through the three points.
        return np.asarray(((near - here) * (b / a) - (far - here) * (a / b)) / (b - a))

    def _moved(self, x: FloatArray, k: int, to: float) -> tuple[float, FloatArray]:
        moved = x.copy()
        moved[k] = min(max(to, self.low[k]), self.high[k])
        return float(moved[k]), self.function(moved)


def _extrapolated(large: FloatArray, small: FloatArray) -> FloatArray:
    """What the differences of two steps, whose errors fall with their square, tend to (Richardson 1911)."""
    with np.errstate(all="ignore"):
        return np.asarray((LADDER**2 * small - large) / (LADDER**2 - 1.0))
