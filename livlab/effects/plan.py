"""Which effects a scene calls for: bounds, the greedy choice of a group to leave out, and its verification.

The bound of a group is how far the instrument's value moves, at the worst wavelength, when all of the group is left
out at once: the difference by adding–doubling, what the solver leaves uncertain, what light lost sideways can add
(`lateral`), and what the solver's mean of short free paths can. A group is left out only if its own bound, never a
sum or the largest of its members', is within the tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from livlab.acquire.instruments.base import VirtualInstrument
from livlab.effects.catalogue import Effect, catalogue
from livlab.effects.config import Force, forced_effects
from livlab.effects.cost import predicted_cost
from livlab.effects.lateral import missed
from livlab.effects.plane import PlaneValue, plane_value, unseen, without_short_paths
from livlab.effects.scene import OpticalScene
from livlab.errors import InputError
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tissue.tissue import Tissue

if TYPE_CHECKING:
    import pandas as pd

    from livlab.units import FloatArray

WORTH_IT = 0.01
"""Least predicted saving for which accuracy is given up."""

COLUMNS = ("effect", "bound", "decision", "predicted_saving", "measured_saving", "why")
TOGETHER = "(all that are dropped)"

Decision = Literal["kept", "dropped", "forced on", "forced off", "not applicable"]
Dropped = frozenset[str]


@dataclass(frozen=True)
class PlanRow:
    """One effect in a plan.

    Attributes
    ----------
    bound
        How far the value moves if it alone is left out; NaN where nothing bounds it.
    predicted_saving
        Share of a photon's cost that leaving it out alone saves; negative if it costs.
    measured_saving
        The same in time for equal standard error, once measured.
    """

    effect: str
    what: str
    bound: float
    decision: Decision
    predicted_saving: float
    why: str
    measured_saving: float | None = None


@dataclass(frozen=True)
class Plan:
    """What of a scene is simulated, and why.

    Attributes
    ----------
    scene
        In full.
    reduced
        Without what was dropped.
    rows
        One an effect, in the catalogue's order.
    tolerance
        How far the value may move, in the value's unit.
    bound
        How far it moves at most with all dropped effects left out together.
    predicted_saving, measured_saving
        Of all of them together.
    """

    scene: OpticalScene
    reduced: OpticalScene
    effects: tuple[Effect, ...] = field(repr=False)
    rows: tuple[PlanRow, ...]
    tolerance: float
    bound: float
    predicted_saving: float
    measured_saving: float | None = None

    @property
    def dropped(self) -> tuple[str, ...]:
        """Names of the effects that are left out."""
        return tuple(r.effect for r in self.rows if r.decision in ("dropped", "forced off"))

    @property
    def instrument(self) -> VirtualInstrument:
        """The instrument over the reduced stack."""
        return self.reduced.instrument

    def apply(self, stack: OpticalStack) -> OpticalStack:
        """The reduced stack: what a walk or a ledger then runs.

        Raises
        ------
        InputError
            A stack of other wavelengths or layers than planned for: the bounds would say nothing of it.
        """
        own = self.scene.stack
        if not np.array_equal(stack.wavelength_nm, own.wavelength_nm) or [x.name for x in stack.layers] != [
            x.name for x in own.layers
        ]:
            raise InputError.of("stack", stack.name, "has other wavelengths or layers than the plan's", "Plan anew.")
        return without(replace(self.scene, stack=stack), self.effects, frozenset(self.dropped)).stack

    def records(self) -> list[dict[str, object]]:
        """The table's rows by `COLUMNS`, as a run folder's plan.csv holds them; the group of all dropped last."""
        rows: list[dict[str, object]] = [{name: getattr(r, name) for name in COLUMNS} for r in self.rows]
        if self.dropped:
            rows.append(
                {
                    "effect": TOGETHER,
                    "bound": self.bound,
                    "decision": "dropped",
                    "predicted_saving": self.predicted_saving,
                    "measured_saving": self.measured_saving,
                    "why": "together",
                }
            )
        return rows

    def table(self) -> pd.DataFrame:
        """The same as a table."""
        import pandas as pd

        numbers = dict.fromkeys(("bound", "predicted_saving", "measured_saving"), float)
        return pd.DataFrame(self.records(), columns=list(COLUMNS)).astype(numbers)


def without(scene: OpticalScene, effects: tuple[Effect, ...], dropped: Dropped) -> OpticalScene:
    """The scene with some effects left out, in the catalogue's order."""
    for e in effects:
        if e.name in dropped and e.drop is not None:
            scene = e.drop(scene)
    return scene


class Bounds:
    """Bounds of groups of effects in one scene; what was worked out once is kept."""

    def __init__(self, scene: OpticalScene, effects: tuple[Effect, ...], *, literal: bool = False) -> None:
        self.scene, self.effects, self.literal = scene, effects, literal
        self.reason = unseen(scene)
        self.tolerance = 0.0
        self.width = len(scene.stack.wavelength_nm)
        self._values: dict[Dropped, PlaneValue] = {}
        self._missed: dict[Dropped, FloatArray] = {}
        self._short: dict[Dropped, FloatArray] = {}
        self._costs: dict[Dropped, float] = {}

    def reduced(self, dropped: Dropped) -> OpticalScene:
        """The scene without a group."""
        return without(self.scene, self.effects, dropped)

    def value(self, dropped: Dropped) -> PlaneValue:
        """The endless reading without a group."""
        # Where a sample ends sideways does not show in it.
        key = dropped - {"lateral-loss"}
        if key not in self._values:
            scene = self.reduced(key)
            self._values[key] = plane_value(scene.stack, scene.instrument)
        return self._values[key]

    def missed(self, dropped: Dropped) -> FloatArray:
        """Bound of what is lost sideways without a group."""
        if dropped not in self._missed:
            self._missed[dropped] = missed(self.reduced(dropped), self.value(dropped), 0.05 * self.tolerance)
        return self._missed[dropped]

    def short(self, dropped: Dropped) -> FloatArray:
        """How much absorption by short free paths takes from the reading without a group: the mean may err by it."""
        if dropped not in self._short:
            scene = self.reduced(dropped)
            clear = without_short_paths(scene.stack)
            none = np.zeros(self.width)
            self._short[dropped] = (
                none if clear is None else plane_value(clear, scene.instrument).difference(self.value(dropped))
            )
        return self._short[dropped]

    def group(self, dropped: Dropped) -> FloatArray:
        """(W,) bound of how far the value moves without a group."""
        if not dropped:
            return np.zeros(self.width)
        if self.reason:
            return np.full(self.width, np.nan)
        bound = self.value(dropped).difference(self.value(frozenset()))
        bound = bound + self.short(dropped) + self.short(frozenset())
        if not self.scene.instrument.edges():
            return bound
        if "lateral-loss" in dropped:
            return bound + self.missed(frozenset())
        kinds = {e.absorbs_only for e in self.effects if e.name in dropped}
        if kinds in ({-1}, {1}):
            # Every path's weight moves the same way, so the paths inside move the value less than all of them do.
            return bound
        least = bound + self.missed(frozenset())
        if np.max(least) > self.tolerance > 0:
            return least  # too much already: what the reduced scene loses could only add to it
        return bound + np.maximum(self.missed(frozenset()), self.missed(dropped))

    def worst(self, dropped: Dropped) -> float:
        """The bound at the worst wavelength; NaN where nothing bounds it."""
        return float(np.max(self.group(dropped)))

    def cost(self, dropped: Dropped) -> float:
        """Predicted cost of a photon without a group."""
        if dropped not in self._costs:
            self._costs[dropped] = predicted_cost(self.reduced(dropped), literal=self.literal)
        return self._costs[dropped]

    def saving(self, dropped: Dropped) -> float:
        """Share of the full scene's cost that leaving a group out saves."""
        return 1.0 - self.cost(dropped) / self.cost(frozenset())

    def top(self) -> float:
        """Maximum of the curve, from below where light is lost sideways."""
        if self.reason:
            return float("nan")
        return float(np.max(self.value(frozenset()).fine - self.missed(frozenset())))


def plan(
    stack: OpticalStack,
    instrument: VirtualInstrument,
    tolerance: float = 0.002,
    forced: Mapping[str, Force] | None = None,
    *,
    tolerance_of: Literal["value", "maximum"] = "value",
    mode: Literal["auto", "all"] = "auto",
    tissue: Tissue | None = None,
    reading: Reading | None = None,
    literal: bool = False,
) -> Plan:
    """Choose the effects that a scene calls for; the same scene always gives the same plan.

    Parameters
    ----------
    stack, instrument
        The scene; the bounds hold at the stack's wavelengths.
    tolerance
        How far the instrument's value may move at any wavelength, above 0.
    forced
        "on", "off" or "auto" by effect, by name or by pattern with `*`.
    tolerance_of
        Unit of the tolerance: the value's own, or the maximum of its curve.
    mode
        "all" drops nothing but what is forced off.
    tissue, reading
        What the stack was made from, if known; see `catalogue`.
    literal
        Predict savings of the literal walk in place of the weighted one.

    Returns
    -------
    The plan. What is forced off counts in the group's bound, but is no reason to refuse: a bound above the tolerance
    is then said.

    Raises
    ------
    InputError
        A tolerance that is not above 0, or a force that is none of the three.
    ConfigError
        A forced effect that the scene does not have.

    Examples
    --------
    >>> from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
    >>> from livlab.model.tissue.phase.functions import HenyeyGreenstein
    >>> from livlab.model.tissue.stack import plain_stack
    >>> bulk = plain_stack([(1.38, 0.6, 50.0, 140.0, HenyeyGreenstein(0.95))])
    >>> plan(bulk, HyperspectralCamera()).dropped
    ('layer-0-small-angles-90',)
    """
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError.of("tolerance", tolerance, "must be finite and > 0", "Give how far the value may move.")
    scene = OpticalScene(stack, instrument)
    effects = catalogue(scene, tissue, reading)
    rules = forced_effects([e.name for e in effects], forced or {})
    bounds = Bounds(scene, effects, literal=literal)
    if tolerance_of == "maximum":
        tolerance = tolerance * bounds.top()
    bounds.tolerance = tolerance
    off = frozenset(e.name for e in effects if rules.get(e.name) == "off" and e.drop is not None)
    free = [e.name for e in effects if e.drop is not None and e.name not in rules] if mode == "auto" else []
    chosen = _choose(bounds, free, off, tolerance) if not bounds.reason else off
    rows = tuple(_row(e, bounds, rules, chosen, tolerance, mode) for e in effects)
    reduced = bounds.reduced(chosen)
    return Plan(scene, reduced, effects, rows, tolerance, bounds.worst(chosen), bounds.saving(chosen))


def _choose(bounds: Bounds, free: list[str], off: Dropped, tolerance: float) -> Dropped:
    """The cheaper of two greedy groups: by saving for its bound, and by saving alone."""
    alone = {name: (bounds.worst(off | {name}), bounds.saving(off | {name}) - bounds.saving(off)) for name in free}
    fit = [n for n in free if alone[n][0] <= tolerance and alone[n][1] >= WORTH_IT]
    orders = (
        sorted(fit, key=lambda n: (-alone[n][1] / max(alone[n][0], 1e-3 * tolerance), n)),
        sorted(fit, key=lambda n: (-alone[n][1], n)),
    )
    groups = [_greedy(bounds, order, off, tolerance) for order in orders]
    return min(groups, key=lambda g: (bounds.cost(g), sorted(g)))


def _greedy(bounds: Bounds, order: list[str], off: Dropped, tolerance: float) -> Dropped:
    group = off
    for name in order:
        wider = group | {name}
        if bounds.saving(wider) - bounds.saving(group) >= WORTH_IT and bounds.worst(wider) <= tolerance:
            group = wider
    # What a later choice has made idle (a small cone within a wider one) is not left out in name only.
    for name in [n for n in order if n in group]:
        rest = group - {name}
        if bounds.saving(group) - bounds.saving(rest) < 0.1 * WORTH_IT and bounds.worst(rest) <= tolerance:
            group = rest
    return group


def _row(
    e: Effect, bounds: Bounds, rules: Mapping[str, Force], chosen: Dropped, tolerance: float, mode: str
) -> PlanRow:
    if e.drop is None:
        return PlanRow(e.name, e.what, math.nan, "not applicable", math.nan, "tracer only")
    one = frozenset({e.name})
    bound, saving = bounds.worst(one), bounds.saving(one)
    fits = bound <= tolerance
    decision: Decision
    if e.name in rules:
        decision = "forced on" if rules[e.name] == "on" else "forced off"
        why = "too much" if decision == "forced off" and not fits else "as configured"
    elif e.name in chosen:
        decision, why = "dropped", "small enough"
    else:
        decision = "kept"
        if mode == "all":
            why = "all were asked for"
        elif bounds.reason:
            why = bounds.reason
        elif not fits:
            why = "too much"
        elif saving < WORTH_IT:
            why = "saves nothing"
        elif bounds.cost(chosen | one) > (1.0 - WORTH_IT) * bounds.cost(chosen):
            why = "saves nothing beside the dropped"
        else:
            why = "too much with the dropped"
    return PlanRow(e.name, e.what, bound, decision, saving, why)
