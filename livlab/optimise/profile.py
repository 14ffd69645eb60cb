"""Profile likelihood: intervals that follow the objective where it is no parabola."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from livlab.errors import InputError
from livlab.optimise.covariance import normal_quantile
from livlab.optimise.driver import minimise
from livlab.optimise.guard import Gradient, Objective
from livlab.optimise.parameters import Parameter, ParameterSpace

STEPS_OUT = 40
ROOT_STEPS = 30


@dataclass(frozen=True, eq=False)
class Profile:
    """Interval of one parameter from its profile.

    Attributes
    ----------
    name, level
        Which parameter, which coverage.
    lower, value, upper
        The interval and the minimum; a side that the data leave open ends at the bound (or infinity).
    open_below, open_above
        Whether a side is open.
    curve
        Frame of the points visited: value of the parameter, rise of the objective over its minimum, and the others.
    lower_minimum
        Values of a better minimum that the profile met, or None.
    evaluations
        Calls of the objective.
    """

    name: str
    level: float
    lower: float
    value: float
    upper: float
    open_below: bool
    open_above: bool
    curve: pd.DataFrame
    lower_minimum: dict[str, float] | None
    evaluations: int


def profile(
    objective: Objective,
    parameters: Sequence[Parameter] | ParameterSpace,
    best: Mapping[str, float],
    name: str,
    *,
    level: float = 0.6827,
    one_sigma: float = 0.5,
    gradient: Gradient | None = None,
    step: float | None = None,
    max_evaluations: int = 20_000,
) -> Profile:
    """Where the objective, minimised over all other parameters, rises by one_sigma z² (Venzon & Moolgavkar 1988).

    Parameters
    ----------
    objective, parameters, one_sigma, gradient
        As given to `minimise`.
    best
        Its result's `best`.
    name
        A free parameter.
    level
        Coverage of the interval; z is the normal quantile.
    step
        First step, in the transformed parameter; a thousandth of it (or of 1) if not given.
    max_evaluations
        Limit of the whole profile; a side not finished by then is open.

    Raises
    ------
    InputError
        The parameter is not free.
    """
    space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
    if name not in space.names:
        raise InputError.of("name", name, "is no free parameter", f"Choose from {list(space.names)}.")
    rise_wanted = one_sigma * normal_quantile(level) ** 2
    centre_values = dict(best)
    own = space.by_name[name]
    walker = _Walker(objective, gradient, space, own, one_sigma, max_evaluations)
    base = walker.at(own.inward(centre_values[name]), centre_values)[0]
    t0 = own.inward(centre_values[name])
    first = step if step is not None else 1e-3 * max(1.0, abs(t0) if own.transform == "linear" else 1.0)
    sides = [_side(walker, t0, base, rise_wanted, sign * first, centre_values) for sign in (-1.0, 1.0)]
    curve = pd.DataFrame(walker.rows).sort_values(name, ignore_index=True)
    curve.insert(1, "rise", curve.pop("objective") - base)
    better = curve.iloc[int(curve["rise"].argmin())]
    lower_minimum = None
    if float(better["rise"]) < -1e-3 * one_sigma:
        lower_minimum = {str(k): float(v) for k, v in better.items() if k != "rise"}
    (lower, open_below), (upper, open_above) = sides
    return Profile(
        name=name,
        level=level,
        lower=lower,
        value=centre_values[name],
        upper=upper,
        open_below=open_below,
        open_above=open_above,
        curve=curve,
        lower_minimum=lower_minimum,
        evaluations=walker.evaluations,
    )


class _Walker:
    """The objective minimised over the others, at a fixed transformed value of one parameter."""

    def __init__(
        self,
        objective: Objective,
        gradient: Gradient | None,
        space: ParameterSpace,
        own: Parameter,
        one_sigma: float,
        limit: int,
    ) -> None:
        self.objective, self.gradient, self.space, self.own = objective, gradient, space, own
        self.one_sigma, self.limit = one_sigma, limit
        self.evaluations = 0
        self.rows: list[dict[str, float]] = []

    def at(self, t: float, near: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        value = self.own.outward(t)
        moved = [
            replace(p, fixed=True, start=value)
            if p.name == self.own.name
            else replace(p, start=min(max(near[p.name], p.low), p.high))
            if p.name in self.space.names
            else p
            for p in self.space.parameters
        ]
        left = max(1, self.limit - self.evaluations)
        free = len(self.space.names) - 1
        found = minimise(
            self.objective,
            moved,
            gradient=self.gradient,
            algorithm="LD_SLSQP" if self.gradient is not None else "LN_BOBYQA",
            max_evaluations=min(left, 300 * (free + 1)),
            value_tolerance=1e-10,
            one_sigma=self.one_sigma,
            warn=False,
            test=False,
        )
        self.evaluations += found.evaluations
        self.rows.append({**found.best, "objective": found.value})
        return found.value, found.best


def _side(
    walker: _Walker, t0: float, base: float, wanted: float, step: float, values: Mapping[str, float]
) -> tuple[float, bool]:
    """Walk outwards in growing steps until the rise is passed, then close in; (end, whether open)."""
    own = walker.own
    edge = own.inward(own.high if step > 0 else own.low)
    inner, inner_rise, near = t0, 0.0, dict(values)
    outer, outer_rise = t0, 0.0
    for _ in range(STEPS_OUT):
        outer = min(t0 + step, edge) if step > 0 else max(t0 + step, edge)
        value, found = walker.at(outer, near)
        outer_rise = value - base
        if outer_rise >= wanted:
            break
        if outer == edge or walker.evaluations >= walker.limit:
            return own.high if step > 0 else own.low, True
        inner, inner_rise, near = outer, outer_rise, found
        # A parabola through the minimum says how far to go; twice at least, lest a flat start stall.
        grow = math.sqrt(1.2 * wanted / outer_rise) if outer_rise > 0 else 8.0
        step *= min(max(grow, 1.3), 8.0)
    else:
        return own.high if step > 0 else own.low, True
    return own.outward(_close_in(walker, (inner, inner_rise), (outer, outer_rise), base, wanted, near)), False


def _close_in(
    walker: _Walker,
    inner: tuple[float, float],
    outer: tuple[float, float],
    base: float,
    wanted: float,
    near: Mapping[str, float],
) -> float:
    """The crossing between two points, by regula falsi on the root of the rise (Illinois variant)."""
    signed: Callable[[float], float] = lambda rise: math.copysign(math.sqrt(abs(rise)), rise) - math.sqrt(wanted)  # noqa: E731
    (a, fa), (b, fb) = (inner[0], signed(inner[1])), (outer[0], signed(outer[1]))
    side = 0
    t = b
    for _ in range(ROOT_STEPS):
        if walker.evaluations >= walker.limit:
            break
        t = (a * fb - b * fa) / (fb - fa)
        value, _ = walker.at(t, near)
        ft = signed(value - base)
        if abs(ft) < 1e-3 * math.sqrt(wanted):
            break
        if ft > 0:
            b, fb = t, ft
            fa = fa * 0.5 if side == 1 else fa
            side = 1
        else:
            a, fa = t, ft
            fb = fb * 0.5 if side == -1 else fb
            side = -1
    return t
