"""Whether an end is a minimum, by the objective alone: its slope and curvature by differences, beside its own noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from livlab.optimise.guard import Guard, Halt
from livlab.optimise.jitter import chance_error
from livlab.optimise.result import Convergence
from livlab.units import FloatArray

NOISES = 100.0
"""Rise of the objective along an axis, in units of its noise, that steps aim at, at least."""

SHARE = 1e-4
"""The same as a share of the objective's value."""

RISE = 0.1
"""The same in units of one_sigma, at most (James & Roos 1975)."""

CLOSE_VALUE = 1e-7
"""Share of the objective that may still be promised at an end that is called converged."""

CLOSE_RISE = 1e-4
"""Share of one_sigma that may still be promised at such an end: a hundredth of a standard deviation."""

CLOSE_WAY = 1e-3
"""Share of its box that a parameter may still be asked to move at such an end."""

TINY_WAY, TINY_GAIN = 1e-6, 1e-10
"""The same where the value itself goes to 0: share of the box, and of what the whole search gained."""

NOISY = 1e-9
"""Noise over the objective's value from which it is more than rounding."""

FINE = 0.2
"""Share of such a rise that the last look along a noisy objective's own axes takes, since valleys are curved."""

TURNS = 3
"""Times that the axes of a noisy objective's parabola are looked for anew, each along those found before."""

PAIRS = 12
"""Parameters up to which every pair is looked at."""

TRIES = 24
"""Steps tried along an axis, at most."""


@dataclass(frozen=True, eq=False)
class Axis:
    """The objective along a line through the end.

    Attributes
    ----------
    way
        (n,) displacement of x; backwards along the line if only that side has room.
    slope, bend
        Change over it to first and second order.
    central
        Whether both sides have room.
    flat
        Whether the objective does not change at all.
    """

    way: FloatArray
    slope: float
    bend: float
    central: bool = True
    flat: bool = False


@dataclass(frozen=True, eq=False)
class Examined:
    """What was found about an end.

    Attributes
    ----------
    convergence
        The verdict.
    steps, rise
        (n,) distances in x over which the objective changes about alike, and by how much.
    """

    convergence: Convergence
    steps: FloatArray
    rise: float = 0.0


def examine(guard: Guard, first: float, one_sigma: float) -> Examined:
    """Test the guard's best point; lower points met on the way are kept by the guard.

    Parameters
    ----------
    guard
        With evaluations left to test with.
    first
        The objective where the search began.
    one_sigma
        Its rise that marks one standard deviation.
    """
    look = _Look(guard, one_sigma)
    try:
        return look.examine(first)
    except Halt:
        why = guard.reason or "the search had to end"
        return Examined(Convergence(False, f"{why} before the end could be tested"), np.ones(look.x.size))


class _Look:
    def __init__(self, guard: Guard, one_sigma: float) -> None:
        assert guard.best_x is not None
        self.guard, self.space, self.one_sigma = guard, guard.space, one_sigma
        self.x, self.value = guard.best_x.copy(), guard.best
        self.sizes = self.space.sizes(self.x)
        self.noise = 0.0

    def at(self, x: FloatArray) -> float:
        """The objective, counted."""
        return self.guard.spend(x)

    def examine(self, first: float) -> Examined:
        """Noise, axes, pairs; then what the parabola through them promises."""
        low, high = self.space.low, self.space.high
        found = chance_error(lambda x: np.array([self.at(x)]), self.x, low, high, self.sizes)
        rounding = 0.5 * float(np.finfo(np.float64).eps) * abs(self.value)
        self.noise = max(found if math.isfinite(found) else 0.0, rounding)
        target = max(NOISES * self.noise, min(SHARE * abs(self.value), RISE * self.one_sigma))
        target = target if target > 0 else 1e-12 * self.one_sigma
        unit = np.eye(self.x.size)
        axes = [self.axis(unit[k], 1e-4 * float(self.sizes[k]), target) for k in range(self.x.size)]
        steps = np.array([float(np.abs(a.way).max()) for a in axes])
        rise = float(np.median([max(abs(a.slope), abs(a.bend)) for a in axes]))
        if all(a.flat for a in axes):
            return Examined(Convergence(False, "the objective is flat there", 0.0, self.noise, flat=True), steps)
        way, promised, lines = self.newton(axes)
        if self.noise > NOISY * abs(self.value):
            for _ in range(TURNS):
                lines = self.turned(lines, target)
            way, promised = self.along_lines([self.axis(line, 1.0, FINE * target) for line in lines.T])
        gained = self.value - self.guard.best
        words = f"the slope promises {promised:.2g} more"
        gone = [self.space.names[k] for k, axis in enumerate(axes) if axis.flat and self.matters(k)]
        if gone:
            told = f"the objective does not depend on {', '.join(gone)} there, though elsewhere it does"
            return Examined(self.told(False, told, promised), steps)
        if self.small(max(promised, gained), way, first):
            return Examined(self.told(True, f"{words} at most", promised), steps)
        if gained > 3.0 * self.noise:
            told = f"a lower value lies beside it{self.doubt(axes)}"
            return Examined(self.told(False, told, max(gained, promised)), steps, rise)
        if promised <= 4.0 * self.noise:
            return Examined(self.told(True, f"{words}, less than the objective's own noise", promised), steps)
        if self.falls(way, promised):
            words = f"{words}, and the objective falls that way{self.doubt(axes)}"
            return Examined(self.told(False, words, promised), steps, rise)
        if any(self.sinks(axis) for axis in axes):
            return Examined(self.told(False, f"{words}, but only farther away: a plateau", promised), steps)
        return Examined(self.told(True, "no value beside it is lower: a kink, or noise", promised), steps)

    def matters(self, k: int) -> bool:
        """Whether another value of a parameter changes the objective, though values near by do not."""
        values = (self.at(moved) for moved in self.space.elsewhere(self.x, k))
        return any(math.isfinite(v) and abs(v - self.value) > 3.0 * self.noise for v in values)

    def sinks(self, axis: Axis) -> bool:
        """Whether smaller steps along an axis change far less than the parabola says, and one side does not rise."""
        if axis.flat or all(self.rises(axis.way * sign) for sign in (1.0, -1.0)):
            return False
        share = 0.25
        for _ in range(TRIES):
            wanted = share * abs(axis.slope) + share**2 * abs(axis.bend)
            if wanted <= 9.0 * self.noise:
                break
            if max(abs(self.at(self.x + way * axis.way) - self.value) for way in (share, -share)) < 0.2 * wanted:
                return True
            share *= 0.25
        return False

    def rises(self, way: FloatArray) -> bool:
        """Whether the objective rises along a way before it falls, or a bound is met at once."""
        room, share = self.room(way), 1.0
        if room <= 0.0:
            return True
        for _ in range(TRIES // 2):
            value = self.at(self.x + min(share, room) * way)
            if value > self.value + 3.0 * self.noise or value < self.value - 3.0 * self.noise:
                return value > self.value
            if share >= room:
                break
            share *= 4.0
        return False

    def told(self, converged: bool, words: str, promised: float) -> Convergence:
        """The verdict as a record."""
        return Convergence(converged, words, promised, self.noise)

    def small(self, promised: float, way: FloatArray, first: float) -> bool:
        """Whether what is promised is little beside value, noise and box."""
        room = self.space.high - self.space.low
        width = np.where(np.isfinite(room), room, np.maximum(self.sizes, np.abs(self.x - self.space.start)))
        share = float(np.max(np.abs(way) / width, initial=0.0))
        if promised > CLOSE_RISE * self.one_sigma:
            return False
        if promised <= CLOSE_VALUE * abs(self.value) and share <= CLOSE_WAY:
            return True
        return promised <= TINY_GAIN * (first - self.value) and share <= TINY_WAY

    def axis(self, line: FloatArray, step: float, target: float) -> Axis:
        """Slope and bend along a line, over a step that changes the objective by about `target`.

        Parameters
        ----------
        line
            (n,) displacement of x that counts as one.
        step
            The first one tried.
        target
            Change of the objective.
        """
        above, below = self.room(line), self.room(-line)
        side, most, near = (1.0 if above >= below else -1.0), max(above, below), min(above, below)
        step = min(step, 1e-4 * most) if math.isfinite(most) and step > most else step
        found, off = Axis(side * step * line, 0.0, 0.0, near >= step, flat=True), math.inf
        for _ in range(TRIES):
            step = near if 0.1 * step < near < step else min(step, most)
            central = near >= step
            values = [self.along(line, s) for s in ((-step, step) if central else (0.5 * side * step, side * step))]
            if not all(map(math.isfinite, values)):
                step *= 0.25
                continue
            a, b = values[0] - self.value, values[1] - self.value
            bend, slope = (0.5 * (a + b), 0.5 * (b - a)) if central else (2.0 * b - 4.0 * a, 4.0 * a - b)
            size = max(abs(bend), abs(slope))
            if size > 3.0 * self.noise and abs(math.log(size / target)) < off:
                way = step * line if central else side * step * line
                found, off = Axis(way, slope, bend, central), abs(math.log(size / target))
            wanted = math.sqrt(target / size) if abs(bend) >= abs(slope) and size > 0 else target / max(size, 1e-300)
            if 0.4 * target <= size <= 4.0 * target or (wanted > 1.0 and step >= most):
                break
            step = min(step * min(max(wanted, 1e-6), 1e3), most)
            if (step * np.abs(line) < 1e-14 * self.sizes).all():
                break
        return found

    def room(self, line: FloatArray) -> float:
        """How many times a displacement fits between the end and the bounds."""
        with np.errstate(divide="ignore", invalid="ignore"):
            up = np.where(line > 0, (self.space.high - self.x) / line, np.inf)
            down = np.where(line < 0, (self.space.low - self.x) / line, np.inf)
        return float(max(min(up.min(), down.min()), 0.0))

    def along(self, line: FloatArray, step: float) -> float:
        """The objective at a point of a line."""
        return self.at(self.x + step * line)

    def newton(self, axes: list[Axis]) -> tuple[FloatArray, float, FloatArray]:
        """(n,) the step in x to the lowest point of the parabola in the box, what it promises, and its own axes."""
        from scipy.optimize import lsq_linear

        used = [k for k, axis in enumerate(axes) if not axis.flat]
        step = np.array([axes[k].way[k] for k in used])
        slope = np.array([axes[k].slope for k in used])
        bend = self.bends(axes, used)
        scale = np.sqrt(np.maximum(np.diag(bend), max(6.0 * self.noise, 1e-9 * float(np.abs(slope).max()))))
        held = np.array([not axes[k].central and axes[k].slope > 0.0 for k in used])
        values, vectors = np.linalg.eigh(bend / np.outer(scale, scale))
        root = (vectors * np.sqrt(np.maximum(values, 1e-9))).T
        pull = np.linalg.solve(root.T, slope / scale)
        sides = np.array([(self.space.low[used] - self.x[used]) / step, (self.space.high[used] - self.x[used]) / step])
        low, high = sides.min(axis=0) * scale, sides.max(axis=0) * scale
        y = lsq_linear(root, -pull, (low, np.maximum(high, low + 1e-300)), method="bvls").x
        way, lines = np.zeros(self.x.size), np.zeros((self.x.size, int((~held).sum())))
        way[used] = y / scale * step
        if lines.shape[1]:
            own = np.linalg.eigh((bend / np.outer(scale, scale))[np.ix_(~held, ~held)])[1]
            lines[np.array(used)[~held]] = own * (step / scale)[~held, None] * float(np.median(scale))
        return way, max(0.0, float(-(pull @ (root @ y)) - 0.5 * np.sum((root @ y) ** 2))), lines

    def turned(self, lines: FloatArray, target: float) -> FloatArray:
        """(n, m) the parabola's own axes, from a look along those that noise had left askew."""
        axes = [axis for axis in (self.axis(line, 1.0, target) for line in lines.T) if not axis.flat]
        if not axes:
            return lines[:, :0]
        bend = self.bends(axes, list(range(len(axes))))
        scale = np.sqrt(np.maximum(np.diag(bend), 6.0 * self.noise))
        vectors = np.linalg.eigh(bend / np.outer(scale, scale))[1]
        return np.asarray((np.array([a.way for a in axes]).T / scale) @ vectors * float(np.median(scale)))

    def along_lines(self, axes: list[Axis]) -> tuple[FloatArray, float]:
        """The same from the parabola's own axes, each looked at over a step that rises above the noise."""
        way, promised = np.zeros(self.x.size), 0.0
        for axis in axes:
            if axis.flat:
                continue
            bend = max(axis.bend, 3.0 * self.noise)
            share = min(max(-0.5 * axis.slope / bend, -self.room(-axis.way)), self.room(axis.way))
            way += share * axis.way
            promised += max(0.0, -share * axis.slope - share**2 * bend)
        return np.clip(self.x + way, self.space.low, self.space.high) - self.x, promised

    def bends(self, axes: list[Axis], used: list[int]) -> FloatArray:
        """(u, u) second derivatives over the axes' steps, from one more value a pair."""
        bend = np.diag([2.0 * axes[k].bend for k in used])
        if len(used) > PAIRS:
            return bend
        for a, i in enumerate(used):
            for b, j in enumerate(used[:a]):
                both = self.at(self.x + axes[i].way + axes[j].way) - self.value
                if math.isfinite(both):
                    bend[a, b] = bend[b, a] = both - sum(axes[k].slope + axes[k].bend for k in (i, j))
        return bend

    def doubt(self, axes: list[Axis]) -> str:
        """What to say of a gradient that does not agree with the objective."""
        told = self.guard.slope_at(self.x)
        if told is None:
            return ""
        for k, axis in enumerate(axes):
            by_gradient, size = float(told @ axis.way), abs(axis.slope) + abs(axis.bend)
            if abs(by_gradient - axis.slope) > 0.2 * size + 0.2 * abs(by_gradient) + 10.0 * self.noise:
                return f"; the gradient by {self.space.names[k]} does not agree with the objective"
        return ""

    def falls(self, way: FloatArray, promised: float) -> bool:
        """Whether the objective does fall along a promising way."""
        share = 1.0
        while share * promised > max(3.0 * self.noise, 1e-6 * promised):
            if self.at(self.x + share * way) < self.value - max(3.0 * self.noise, 1e-3 * share * promised):
                return True
            share *= 0.25
        return False
