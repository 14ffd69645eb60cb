"""Which solver: the cheapest that holds everywhere and can meet the wish, by what short trials of each take."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.accuracy import Accuracy
from livlab.model.transport.geometry import Readout
from livlab.model.transport.ladder.approximate import (
    DIFFUSION_BOUND,
    DIFFUSION_RING_BOUND,
    KUBELKA_MUNK_BOUND,
    diffusion_value,
    kubelka_munk_value,
)
from livlab.model.transport.ladder.by_ledger import Recorded, pilot, seconds_for
from livlab.model.transport.ladder.domain import SOLVERS, domain
from livlab.model.transport.sampling import Clock, SamplingRule, Walks
from livlab.model.transport.walk.tables import Estimator

WORTH_NO_WALK = 3.0
"""Seconds of adding–doubling below which a walk is not even tried: its compiling and its pilot take as long."""

SPARE = 0.2
"""Adding–doubling is asked for this share of the wished error: it is gauged at one wavelength only."""

TOLERANCES = (1e-9, 1e-4)
"""Finest and coarsest tolerance that is asked of adding–doubling."""


LEAST_WAVELENGTHS = 8
"""Wavelengths from which on one recorded walk for all is worth a trial."""


@dataclass(frozen=True)
class Picked:
    """A solver, and what its choice has already brought.

    Attributes
    ----------
    solver
        Its name.
    seconds
        Time it was thought to take, if that was gauged.
    tolerance
        For adding–doubling.
    walks
        For a walk: its state after the pilot, if there was one.
    recorded
        For the ledger: its pilot.
    notes
        Why this solver.
    """

    solver: str
    seconds: float | None
    tolerance: float | None
    walks: Walks | None
    notes: tuple[str, ...]
    recorded: Recorded | None = None


def pick(
    stack: OpticalStack,
    view: Readout,
    accuracy: Accuracy,
    *,
    account: bool = False,
    sampling: SamplingRule | None = None,
    variant: str = "llvm",
    clock: Clock = time.perf_counter,
) -> Picked:
    """Choose the cheapest solver that can meet a wish.

    Two fluxes and diffusion answer where they hold and the wish is no finer than what they are off. Adding–doubling
    answers where it holds at every wavelength, unless a piloted walk would be done before it. Else the walk of
    expected values does, or the ledger where that would be done sooner: one walk for all of many wavelengths. The
    literal walk gives the same with more samples and is never chosen. What is not listed is as in `ladder.solve`.

    Parameters
    ----------
    account
        Whether the light's whole account is wanted beside the reading, which two fluxes, diffusion and the ledger do
        not give (it cannot tell in which layer light was absorbed).
    """
    started = clock()
    if not account and accuracy.seconds is None:
        crude = _crude(stack, view, accuracy)
        if crude is not None:
            return crude
    where = domain("adding-doubling", stack, view)
    exact = None
    if where.valid.all():
        tolerance, seconds = _gauge(stack, view, accuracy, clock)
        exact = Picked("adding-doubling", seconds, tolerance, None, (f"auto: adding-doubling, about {_s(seconds)}",))
        left = math.inf if accuracy.seconds is None else accuracy.seconds - (clock() - started)
        if seconds <= min(left, WORTH_NO_WALK) or (accuracy.seconds is not None and seconds <= left):
            return exact
    why = f"; adding-doubling: {'; '.join(where.reasons)}" if where.reasons else ""
    if exact is not None:
        why = f"; adding-doubling would take about {_s(exact.seconds or 0.0)}"
    rule = rule_of(accuracy, "walk expected", sampling)
    kept = None if account else _ledger(stack, view, rule.seed, variant, clock)
    if accuracy.seconds is not None:
        if kept is not None:
            return Picked("ledger", None, None, None, (f"auto: ledger, one walk for all wavelengths{why}",), kept)
        # At least a sliver: a wish that the gauging used up is still answered, by one launch.
        left = max(accuracy.seconds - (clock() - started), 0.01 * accuracy.seconds)
        rule = replace(rule, seconds=left)
    walks = Walks(stack, view, rule, variant=variant, clock=clock)
    if accuracy.seconds is not None or (exact is None and kept is None):
        return Picked("walk expected", None, None, walks, (f"auto: walk expected{why}",))
    first = walks.plan()
    assert first is not None
    walks.launch(*first)
    found = [Picked("walk expected", walks.done()[1], None, walks, ())]
    found += [exact] if exact is not None else []
    found += [Picked("ledger", seconds_for(kept, accuracy), None, None, (), kept)] if kept is not None else []
    best = min(found, key=lambda p: p.seconds or 0.0)
    said = ", ".join(f"{p.solver} would take about {_s(p.seconds or 0.0)} more" for p in found)
    more = why if exact is None else ""
    return replace(best, notes=(f"auto: {best.solver}; {said}{more}",))


def rule_of(accuracy: Accuracy, solver: str, sampling: SamplingRule | None = None) -> SamplingRule:
    """What rules a walk that is to meet a wish: limits and seed as given, rule and estimator replaced."""
    if solver not in SOLVERS:
        raise InputError.of("solver", solver, f"must be auto or one of {', '.join(SOLVERS)}", "Name one of them.")
    base = sampling or SamplingRule(relative=0.01)
    estimator = cast(Estimator, solver.removeprefix("walk ")) if solver.startswith("walk ") else base.estimator
    return replace(base, samples=None, estimator=estimator, **accuracy.model_dump())


def _ledger(stack: OpticalStack, view: Readout, seed: int, variant: str, clock: Clock) -> Recorded | None:
    """The ledger's pilot, where there is one to be kept and it answers everywhere."""
    if len(stack.wavelength_nm) < LEAST_WAVELENGTHS or not domain("ledger", stack, view).valid.all():
        return None
    try:
        found = pilot(stack, view, seed, variant=variant, clock=clock)
    except InputError:  # scattering that changes too much over the band
        return None
    return found if found.valid.all() else None


def _crude(stack: OpticalStack, view: Readout, accuracy: Accuracy) -> Picked | None:
    """Two fluxes or diffusion, if what they are off is no more than wished; the better of the two first."""
    ring = bool(view.tally.radius_edges)
    for solver, bound, of in (
        ("diffusion", DIFFUSION_RING_BOUND if ring else DIFFUSION_BOUND, diffusion_value),
        ("kubelka-munk", KUBELKA_MUNK_BOUND, kubelka_munk_value),
    ):
        if accuracy.relative is not None and accuracy.relative < bound:
            continue
        if not domain(solver, stack, view).valid.all():
            continue
        value = of(stack, view)
        target = accuracy.target(value)
        if target is not None and float(bound * value.max()) <= target:
            return Picked(solver, 0.0, None, None, (f"auto: {solver}, off by at most {100 * bound:g} % here",))
    return None


def tolerance_of(stack: OpticalStack, view: Readout, accuracy: Accuracy) -> float:
    """Tolerance that a wish asks of adding–doubling; a relative one is gauged at the middle wavelength.

    The curve's maximum is at least what one wavelength reads, so that its share is a wish at least as fine.
    """
    from livlab.model.transport.adding_doubling import adding_doubling

    wanted = 1e-6
    if accuracy.seconds is None:
        value = np.zeros(1)
        if accuracy.relative is not None:
            mu0 = math.cos(view.source.angle_rad)
            value = view.of_endless(adding_doubling(_middle(stack), mu0=mu0, tolerance=1e-3, mu_min=view.mu_min))
        wanted = SPARE * (accuracy.target(value) or 0.0) / max(1.0, float(view.weights.max()))
    return min(max(wanted, TOLERANCES[0]), TOLERANCES[1])


def _gauge(stack: OpticalStack, view: Readout, accuracy: Accuracy, clock: Clock) -> tuple[float, float]:
    """Tolerance that the wish asks of adding–doubling, and the seconds that all wavelengths take with it."""
    from livlab.model.transport.adding_doubling import adding_doubling

    started = clock()
    tolerance = tolerance_of(stack, view, accuracy)
    mu0 = math.cos(view.source.angle_rad)
    adding_doubling(_middle(stack), mu0=mu0, tolerance=tolerance, mu_min=view.mu_min)
    return tolerance, (clock() - started) * len(stack.wavelength_nm)


def _middle(stack: OpticalStack) -> OpticalStack:
    return stack.at([len(stack.wavelength_nm) // 2])


def _s(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds < 100 else f"{seconds:.0f} s"
