"""The objective behind a guard: counts, records, survives failures, and knows when to stop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from livlab.optimise.parameters import ParameterSpace
from livlab.units import FloatArray

Objective = Callable[[Mapping[str, float]], float]
Gradient = Callable[[Mapping[str, float]], Mapping[str, float]]
Callback = Callable[[int, Mapping[str, float], float], object]


LARGEST = 1e300
"""Largest number that NLopt is told."""


def _number(given: Any) -> float:
    """A number, or an array of one, as Python's own float: NLopt takes no other."""
    return float(given) if np.ndim(given) == 0 else float(np.asarray(given).reshape(()))


class Halt(Exception):
    """The search has to end: a limit, the callback, or the user; the guard's `reason` says which."""


class Guard:
    """Calls the objective for NLopt: a failed point costs infinity in the record, and a large finite number outside.

    NLopt's models and simplices cannot digest infinities, so it is told the worst finite value seen plus the spread.
    """

    def __init__(
        self,
        objective: Objective,
        gradient: Gradient | None,
        space: ParameterSpace,
        *,
        one_sigma: float,
        max_evaluations: int,
        max_seconds: float,
        callback: Callback | None,
    ) -> None:
        self.objective, self.gradient, self.space = objective, gradient, space
        self.prior_scale = 2.0 * one_sigma
        self.max_evaluations, self.max_seconds, self.callback = max_evaluations, max_seconds, callback
        self.begun = time.perf_counter()
        self.count = self.failures = 0
        self.start = 0
        self.stage = ""
        self.stage_limit = max_evaluations
        self.best_x: FloatArray | None = None
        self.best = math.inf
        self.local_x: FloatArray | None = None
        self.local = math.inf
        self.worst = -math.inf
        self.first_error: BaseException | None = None
        self.interrupted = False
        self.reason: str | None = None
        self.halted: str | None = None
        self.broken: Exception | None = None
        self.factor = 1.0
        self.opt: Any = None
        self.last: tuple[FloatArray, float] | None = None
        self._rows: list[tuple[int, str, float, float, float]] = []
        self._points: list[tuple[float, ...]] = []

    def seconds(self) -> float:
        """Wall time so far."""
        return time.perf_counter() - self.begun

    def begin(self, start: int, stage: str, limit: int) -> None:
        """A new stage of a start: its own best, and its own limit of evaluations."""
        self.start, self.stage, self.stage_limit = start, stage, limit
        self.local_x, self.local = None, math.inf
        self.reason = self.halted

    def penalty(self) -> float:
        """The finite number that stands for a failure."""
        if not math.isfinite(self.best):
            return 1e10
        return min(self.factor * (self.worst + max(self.worst - self.best, abs(self.worst), 1e-8)), LARGEST)

    def stop(self, reason: str) -> None:
        """Ask NLopt to end, and say why."""
        self.reason = self.reason or reason
        if self.opt is not None:
            self.opt.force_stop()

    def evaluate(self, x: FloatArray) -> float:
        """The objective with its prior at x; infinite where it fails."""
        values = self.space.values(x)
        try:
            value = _number(self.objective(values)) + self.prior_scale * self.space.prior(values)
        except Exception as error:
            self.first_error = self.first_error or error
            value = math.inf
        if not math.isfinite(value):
            # Minus infinity is as much a failure as NaN: no minimum can be told from it.
            value = math.inf
            self.failures += 1
        self.count += 1
        self.last = (np.array(x), value)
        if value < self.best:
            self.best, self.best_x = value, np.array(x)
        if value < self.local:
            self.local, self.local_x = value, np.array(x)
        if math.isfinite(value):
            self.worst = max(self.worst, value)
        self._rows.append((self.start, self.stage, self.seconds(), value, self.best))
        self._points.append(tuple(values.values()))
        self._tell(values, value)
        return value

    def _tell(self, values: Mapping[str, float], value: float) -> None:
        """Ask the callback; an error of its own ends the search and is raised once NLopt has been left."""
        if self.callback is None or self.broken is not None:
            return
        try:
            if self.callback(self.count, values, value) is False:
                self.halted = "the callback asked for it"
        except Exception as error:
            self.broken, self.halted = error, "the callback failed"
        if self.halted is not None:
            self.stop(self.halted)

    def probe(self, x: FloatArray) -> float:
        """`evaluate`, but free of cost if x was the last point."""
        if self.last is not None and np.array_equal(self.last[0], x):
            value = self.last[1]
            if value < self.local:
                self.local, self.local_x = value, np.array(x)
            return value
        return self.evaluate(x)

    def spent(self) -> bool:
        """Whether no evaluation or time is left."""
        return self.count >= self.max_evaluations or self.seconds() >= self.max_seconds

    def over(self) -> bool:
        """Whether the search has to end; `reason` then says why."""
        if self.reason is None and self.count >= min(self.max_evaluations, self.stage_limit):
            whole = self.count >= self.max_evaluations
            self.stop("the limit of evaluations was reached" if whole else "its share of the evaluations was used up")
        if self.reason is None and self.seconds() >= self.max_seconds:
            self.stop("the limit of time was reached")
        return self.reason is not None

    def spend(self, x: FloatArray) -> float:
        """`probe` outside NLopt.

        Raises
        ------
        Halt
            The search has to end.
        """
        if self.over():
            raise Halt
        value = self.probe(np.clip(x, self.space.low, self.space.high))
        if self.reason is not None:
            raise Halt
        return value

    def settle(self, x: FloatArray, value: float) -> None:
        """Take a point for the best, though another's value may be lower by rounding."""
        self.best_x, self.best = np.array(x), value

    def rescale(self, factors: FloatArray, rise: float) -> None:
        """See the parameters and the objective in other units from now on: x becomes x / factors, and `rise` 1."""
        self.factor = 1.0 / rise if 1e-300 < rise < LARGEST else 1.0
        self.space = self.space.rescaled(factors)
        self.best_x = None if self.best_x is None else self.best_x / factors
        self.local_x = None if self.local_x is None else self.local_x / factors
        self.last = None

    def __call__(self, x: FloatArray, gradient: FloatArray) -> float:
        """What NLopt calls; never raises, since exceptions do not cross its inner loops unharmed."""
        if self.over():
            gradient[:] = 0.0
            return self.penalty()
        inside = np.clip(np.where(np.isfinite(x), x, self.space.start), self.space.low, self.space.high)
        try:
            value = self.probe(inside)
            if gradient.size:
                gradient[:] = self.factor * self._slope(inside) if math.isfinite(value) else 0.0
        except KeyboardInterrupt:
            self.interrupted = True
            self.stop("interrupted by the user")
            gradient[:] = 0.0
            return self.penalty()
        return self.factor * value if math.isfinite(value) else self.penalty()

    def slope_at(self, x: FloatArray) -> FloatArray | None:
        """(n,) the gradient by x that was given; None if there is none, or it fails."""
        return None if self.gradient is None else self._slope(x)

    def _slope(self, x: FloatArray) -> FloatArray:
        values = self.space.values(x)
        assert self.gradient is not None
        try:
            natural = dict(self.gradient(values))
        except Exception as error:
            self.first_error = self.first_error or error
            return np.zeros(len(self.space.free))
        for name, slope in self.space.prior_gradient(values).items():
            natural[name] = natural.get(name, 0.0) + self.prior_scale * slope
        found = self.space.gradient(x, natural)
        return np.where(np.isfinite(found), found, 0.0)

    def path(self) -> pd.DataFrame:
        """One row an evaluation."""
        frame = pd.DataFrame(self._rows, columns=["start", "stage", "seconds", "value", "best"])
        names = [p.name for p in self.space.parameters]
        points = pd.DataFrame(self._points, columns=names, dtype=float)
        clashes = {n: f"{n}_parameter" for n in names if n in frame.columns}
        whole = pd.concat([frame, points.rename(columns=clashes)], axis=1)
        whole.index.name = "evaluation"
        return whole
