"""What accuracy costs: every solver on one scene, its error measured against the best reference there is.

The reference is adding–doubling where it holds, else the longest walk; its own error is told, and no error near it is
trusted. Errors are root mean squares over the wavelengths and the repeats.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Literal, get_args

import numpy as np
import xarray as xr

from livlab.acquire.instruments.models import Instrument
from livlab.acquire.instruments.solvers import WalkSolver
from livlab.acquire.instruments.spectrometer import Accuracy, Estimate, SamplingRule, Variant, estimate, measure
from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.units import FloatArray

FEWEST, STEP = 1000, 4
"""Samples a wavelength of the first walk, and from one walk to the next."""

ERRORS_WANTED = 24
"""Errors (wavelengths times repeats) that a root mean square is taken of where time allows: known to 14 %."""

WISHES = (1e-3, 1e-5, 1e-7)
"""What is asked of adding–doubling, the last as reference."""

FAR = 3.0
"""An error is trusted if what the solver says of itself is this many times the reference's own."""

COARSEST = Accuracy(standard_error=WISHES[0])

Estimator = Literal["expected", "analog"]
Say = Callable[[str], None]


@dataclass(frozen=True)
class CostRow:
    """One solver at one effort.

    Attributes
    ----------
    solver
        Its name.
    samples
        Over all wavelengths; 0 for a deterministic solver.
    seconds, compile_seconds
        By the clock, compiling apart; and what compiling took.
    error
        Measured against the reference.
    stated
        What the solver says of its own error, NaN where it says nothing.
    trusted
        Whether the reference is good enough to measure it; the reference itself is not measured.
    valid
        Whether the solver holds here at every wavelength.
    repeats
        Runs that the error and the time are means of.
    pareto
        Whether nothing is both faster and more exact.
    reference, reference_error
        What it was measured against, and how far that is to be believed.
    notes
        What the solver does not know here.
    """

    solver: str
    samples: int
    seconds: float
    compile_seconds: float
    error: float
    stated: float
    trusted: bool
    valid: bool
    repeats: int
    pareto: bool
    reference: str
    reference_error: float
    notes: str = ""


COLUMNS = tuple(f.name for f in fields(CostRow))


@dataclass(frozen=True)
class _Tried:
    """A solver's values at one effort, (repeats, W), before they are compared."""

    solver: str
    samples: int
    seconds: float
    compile_seconds: float
    values: FloatArray
    stated: FloatArray
    valid: bool
    notes: str = ""


def cost(
    stack: OpticalStack,
    instrument: Instrument,
    *,
    budget_seconds: float = 60.0,
    seed: int = 1,
    variant: Variant = "llvm",
    say: Say | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> list[CostRow]:
    """Error against time of every solver and sample count, for one scene.

    Parameters
    ----------
    stack, instrument
        The scene.
    budget_seconds
        About how long to try, > 0: half of it goes into the reference where only a walk can give one.
    seed
        Of the first walk; every other has its own.
    variant
        Where walks run.
    say
        Told what is being tried.
    clock
        Seconds, for tests.

    Returns
    -------
    Rows by solver and effort. A solver that cannot answer at all is left out.

    Raises
    ------
    InputError
        A budget that is not positive.
    """
    if not (math.isfinite(budget_seconds) and budget_seconds > 0):
        raise InputError.of("budget", budget_seconds, "must be positive", "Give seconds, such as 60.")
    say = say or (lambda text: None)
    tried: list[_Tried] = []
    started = clock()
    for solver in ("kubelka-munk", "diffusion"):
        say(solver)
        found = _answered(stack, instrument, solver, None)
        tried += [_of(found)] if found is not None else []
    reference = None
    # One wavelength first: phase functions from tables can make the whole a matter of minutes.
    say("adding-doubling: one wavelength")
    gauged = _answered(stack.at([len(stack.wavelength_nm) // 2]), instrument, "adding-doubling", COARSEST)
    share = 0.6 if gauged is not None and gauged.valid.all() else 0.2
    affordable = gauged is not None and gauged.seconds * len(stack.wavelength_nm) <= share * budget_seconds
    for wish in WISHES if affordable else ():
        if reference is not None and _rms(reference.stated) <= wish:
            continue
        say("adding-doubling")
        found = _answered(stack, instrument, "adding-doubling", Accuracy(standard_error=wish))
        if found is None:
            break
        tried.append(_of(found))
        if found.valid.all():
            reference = tried[-1]
        # A hundredth of the error takes some times as long, though phase functions are known by now.
        if clock() - started + 2 * found.seconds > share * budget_seconds:
            break
    if reference is None:
        say("reference: walk expected")
        reference = _longest(stack, instrument, 0.5 * budget_seconds, seed, variant)
        tried.append(reference)
    left = max(budget_seconds - (clock() - started), 0.2 * budget_seconds)
    tried += _ledgers(stack, instrument, 0.3 * left, seed + 500, variant, say, clock)
    for k, estimator in enumerate(get_args(Estimator)):
        tried += _walks(stack, instrument, estimator, 0.35 * left, seed + 1000 * (k + 1), variant, say, clock)
    return _rows(tried, reference)


def slope(rows: list[CostRow], solver: str) -> tuple[float, float]:
    """Slope of ln error over ln samples of a walk, and its standard error; −1/2 is Monte Carlo's.

    Each root mean square of M errors is known to 1/√(2M). Only trusted rows count.

    Raises
    ------
    InputError
        Fewer than two such rows.
    """
    kept = [r for r in rows if r.solver == solver and r.trusted and r.samples > 0]
    if len({r.samples for r in kept}) < 2:
        raise InputError.of("rows", len(kept), f"at least two trusted ones of {solver} are needed", "Raise the budget.")
    x = np.log([r.samples for r in kept])
    y = np.log([r.error for r in kept])
    weight = np.array([float(r.repeats) for r in kept])
    middle = np.average(x, weights=weight)
    spread = float(np.sum(weight * (x - middle) ** 2))
    return float(np.sum(weight * (x - middle) * y)) / spread, 1.0 / math.sqrt(2.0 * spread)


def _answered(
    stack: OpticalStack,
    instrument: Instrument,
    solver: str,
    accuracy: Accuracy | None,
    sampling: SamplingRule | None = None,
    variant: Variant = "llvm",
) -> Estimate | None:
    try:
        return estimate(stack, instrument, accuracy, solver, outside="warn", sampling=sampling, variant=variant)
    except InputError:
        return None


def _of(found: Estimate) -> _Tried:
    return _Tried(
        found.solver,
        found.samples,
        found.seconds,
        0.0,
        found.value.to_numpy()[None],
        found.systematic.to_numpy(),
        bool(found.valid.all()),
        "; ".join(x for x in found.notes if x.startswith(found.solver)),
    )


def _longest(stack: OpticalStack, instrument: Instrument, seconds: float, seed: int, variant: Variant) -> _Tried:
    found = estimate(
        stack,
        instrument,
        Accuracy(seconds=seconds),
        "walk expected",
        sampling=SamplingRule(relative=0.01, seed=seed),
        variant=variant,
    )
    error = found.standard_error.to_numpy()
    return _Tried(found.solver, found.samples, found.seconds, 0.0, found.value.to_numpy()[None], error, True)


def _ledgers(
    stack: OpticalStack,
    instrument: Instrument,
    seconds: float,
    seed: int,
    variant: Variant,
    say: Say,
    clock: Callable[[], float],
) -> list[_Tried]:
    """Ledgers of half the error each, from their pilot's on, until the time is spent; none where there can be none."""
    started, wish, out = clock(), 1e3, list[_Tried]()
    while True:
        say(f"ledger: {len(out) + 1}")
        found = _answered(
            stack, instrument, "ledger", Accuracy(standard_error=wish), SamplingRule(relative=0.1, seed=seed), variant
        )
        if found is None or not found.samples:
            return out
        if wish == 1e3:
            # The first, with no wish to speak of, also loads the compiler: again, for the time.
            found = _answered(
                stack,
                instrument,
                "ledger",
                Accuracy(standard_error=wish),
                SamplingRule(relative=0.1, seed=seed),
                variant,
            )
            assert found is not None
        valid = bool(found.valid.all())
        out.append(replace(_of(found), stated=found.error.to_numpy(), valid=valid))
        if not valid or clock() - started + 5 * found.seconds > seconds:
            return out
        wish, seed = 0.5 * float(found.error.max()), seed + 10


def _walks(
    stack: OpticalStack,
    instrument: Instrument,
    estimator: Estimator,
    seconds: float,
    seed: int,
    variant: Variant,
    say: Say,
    clock: Callable[[], float],
) -> list[_Tried]:
    """Walks of more and more samples until the time is spent."""
    width = len(stack.wavelength_nm)
    out: list[_Tried] = []
    started, samples = clock(), FEWEST
    # The first launch of a process also loads the compiler and its libraries: it is not timed.
    warm = WalkSolver(estimator=estimator, samples=FEWEST, pilot=FEWEST, seed=seed)
    compiled = float(measure(stack, instrument, warm, variant=variant).attrs["compile_seconds"])
    while True:
        say(f"walk {estimator}: {samples * width:,} samples")
        found: list[xr.Dataset] = []
        repeats = max(2, math.ceil(ERRORS_WANTED / width))
        while len(found) < repeats:
            seed += 1
            solver = WalkSolver(estimator=estimator, samples=samples, pilot=min(samples, 10**8), seed=seed)
            found.append(measure(stack, instrument, solver, variant=variant))
            took = found[-1].attrs["seconds"] - found[-1].attrs["compile_seconds"]
            if len(found) == 1:
                repeats = min(repeats, max(1, int(0.2 * seconds / took)))
        compiled += sum(x.attrs["compile_seconds"] for x in found)
        walking = sum(x.attrs["seconds"] - x.attrs["compile_seconds"] for x in found)
        stated = np.sqrt(np.mean([np.square(x["standard_error"].to_numpy()) for x in found], axis=0))
        values = np.array([x["value"].to_numpy() for x in found])
        out.append(
            _Tried(f"walk {estimator}", samples * width, walking / len(found), compiled, values, stated, valid=True)
        )
        if clock() - started + STEP * walking / len(found) > seconds:
            return out
        samples, compiled = samples * STEP, 0.0


def _rows(tried: list[_Tried], reference: _Tried) -> list[CostRow]:
    truth = reference.values.mean(axis=0)
    own = _rms(reference.stated)
    measured = [_rms(t.values - truth) for t in tried]
    stated = [_rms(t.stated) for t in tried]
    trusted = [
        t is not reference and (e if math.isnan(s) else max(e, s)) > FAR * own
        for t, e, s in zip(tried, measured, stated, strict=True)
    ]
    # What cannot be measured is taken at its word, luck for none, and nothing for better than the reference.
    taken = [
        max(e, own, s if t.samples else 0.0) if ok else s
        for t, e, s, ok in zip(tried, measured, stated, trusted, strict=True)
    ]
    rows = []
    for k, t in enumerate(tried):
        beaten = any(
            tried[j].seconds <= t.seconds and taken[j] <= taken[k] and j != k and not _same(j, k, tried, taken)
            for j in range(len(tried))
        )
        rows.append(
            CostRow(
                solver=t.solver,
                samples=t.samples,
                seconds=t.seconds,
                compile_seconds=t.compile_seconds,
                error=measured[k],
                stated=stated[k],
                trusted=trusted[k],
                valid=t.valid,
                repeats=len(t.values),
                pareto=not beaten,
                reference=reference.solver,
                reference_error=own,
                notes=t.notes,
            )
        )
    return rows


def _same(j: int, k: int, tried: list[_Tried], taken: list[float]) -> bool:
    return tried[j].seconds == tried[k].seconds and taken[j] == taken[k] and j > k


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
