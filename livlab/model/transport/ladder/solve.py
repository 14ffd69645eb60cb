"""The ladder of solvers: one question, one form of answer, and the cheapest solver that can meet a wish.

From the crudest to the most general: two fluxes, diffusion's dipole, adding–doubling, the ledger, random walk. Each
states where it holds (`ladder.domain`); outside it is refused, or answers with a warning.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from livlab.criteria import format_value
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
from livlab.model.transport.ladder.by_ledger import until_met
from livlab.model.transport.ladder.domain import SOLVERS, Domain, SolverName, domain, listed
from livlab.model.transport.ladder.pick import Picked, pick, rule_of, tolerance_of
from livlab.model.transport.sampling import Clock, SamplingRule, Walks
from livlab.units import FloatArray

__all__ = ["SOLVERS", "Accuracy", "Domain", "Estimate", "Picked", "SolverName", "domain", "pick", "solve"]


@dataclass(frozen=True)
class Estimate:
    """What a solver says of an instrument's reading, and how far to believe it. Arrays are on `wavelength` in nm.

    Attributes
    ----------
    value
        The reading.
    standard_error
        Its random error; 0 for a deterministic solver.
    systematic
        Bound of its other errors: adding–doubling's own estimate, what two fluxes and diffusion are off within
        their domain, what the light of photons that a walk or a ledger gave up could have added, what a ledger's
        interpolation is off; NaN outside the domain, where nobody knows.
    seconds, samples
        What it took, by the clock, and samples over all wavelengths (0 for a deterministic solver).
    valid
        Whether the solver holds at each wavelength.
    solver
        Its name.
    notes
        Why it was chosen, what it does not know, what was not reached.
    """

    value: xr.DataArray
    standard_error: xr.DataArray
    systematic: xr.DataArray
    seconds: float
    samples: int
    valid: xr.DataArray
    solver: str
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        for name in ("standard_error", "systematic", "valid"):
            if not np.array_equal(getattr(self, name)["wavelength"], self.value["wavelength"]):
                raise InputError.of(name, "", "is on other wavelengths than the value", "Give one a wavelength.")
        if (self.standard_error < 0).any() or (self.systematic < 0).any() or self.seconds < 0 or self.samples < 0:
            raise InputError.of("estimate", self.solver, "errors, seconds and samples must be >= 0", "Mend it.")

    @property
    def error(self) -> xr.DataArray:
        """Random and systematic error together, NaN where nobody knows."""
        together: xr.DataArray = xr.apply_ufunc(np.hypot, self.standard_error, self.systematic)
        return together

    def text(self) -> list[str]:
        """The values, with no digit that the error does not support; "?" follows where the solver does not hold.

        >>> w = {"wavelength": [500.0]}
        >>> a, b, c = (xr.DataArray([x], coords=w, dims="wavelength") for x in (0.123456, 0.0021, 0.0))
        >>> Estimate(a, b, c, 1.0, 1000, a > 0, "walk expected").text()
        ['0.1235']
        """
        out = []
        for value, error, valid in zip(self.value.values, self.error.values, self.valid.values, strict=True):
            known = bool(valid) and math.isfinite(error)
            out.append(format_value(float(value), float(error)) if known else f"{float(value):.1g}?")
        return out

    def dataset(self) -> xr.Dataset:
        """All of it: arrays on wavelength, the rest as attributes."""
        names = ("value", "standard_error", "systematic", "valid")
        made = xr.Dataset({name: getattr(self, name) for name in names})
        made.attrs = {
            "solver": self.solver,
            "seconds": self.seconds,
            "samples": self.samples,
            "notes": "\n".join(self.notes),
        }
        return made


def solve(
    stack: OpticalStack,
    view: Readout,
    accuracy: Accuracy | None = None,
    solver: str = "auto",
    *,
    outside: Literal["refuse", "warn"] = "refuse",
    sampling: SamplingRule | None = None,
    variant: str = "llvm",
    clock: Clock = time.perf_counter,
) -> Estimate:
    """What an instrument reads over a stack, as exactly as wished, by one solver of the ladder.

    Parameters
    ----------
    stack
        Layers and wavelengths.
    view
        The measurement geometry: `instrument.readout(stack.n_above)` of a virtual instrument, or
        `geometry.total_reflectance()`.
    accuracy
        The wish; 1 % of the curve's maximum if none is given.
    solver
        "auto" takes the cheapest solver that can meet the wish; or one of `SOLVERS`.
    outside
        What to do where the solver holds at no wavelength: refuse, or answer all the same and warn. Where it holds at
        some, it answers; `valid` and `notes` say where.
    sampling
        Seed, pilot and limits of a walk; its rule and estimator are replaced.
    variant
        Where a walk runs: "llvm" or "cuda".
    clock
        Seconds, for tests.

    Returns
    -------
    Estimate

    Raises
    ------
    InputError
        No such solver; or one that cannot answer here, or (unless warned only) holds nowhere: the message says why and
        what to use.

    Examples
    --------
    >>> from livlab.model.tissue.phase.functions import Isotropic
    >>> from livlab.model.tissue.stack import plain_stack
    >>> from livlab.model.transport.geometry import total_reflectance
    >>> slab = plain_stack([(1.0, 1.0, 99.0, math.inf, Isotropic())])
    >>> found = solve(slab, total_reflectance(), Accuracy(standard_error=1e-4))
    >>> found.solver, round(float(found.value[0]), 5)
    ('adding-doubling', 0.75272)
    """
    accuracy = accuracy or Accuracy(relative=0.01)
    started = clock()
    notes = list(view.notes)
    if solver == "auto":
        picked = pick(stack, view, accuracy, sampling=sampling, variant=variant, clock=clock)
        notes += picked.notes
    else:
        ruled = rule_of(accuracy, solver, sampling)
        walks = Walks(stack, view, ruled, variant=variant, clock=clock) if solver.startswith("walk") else None
        picked = Picked(solver, None, None, walks, ())
    where = domain(picked.solver, stack, view)
    if not where.possible or (outside == "refuse" and not where.valid.any()):
        raise where.refusal()
    if picked.solver == "adding-doubling" and picked.tolerance is None:
        picked = replace(picked, tolerance=tolerance_of(stack, view, accuracy))
    notes += [f"{picked.solver}: {reason}" for reason in where.reasons]
    valid = where.valid
    if picked.solver == "ledger":
        seed = sampling.seed if sampling is not None else 1
        kept = until_met(stack, view, accuracy, picked.recorded, seed, variant=variant, clock=clock, started=started)
        value, random, systematic, samples = kept.value, kept.standard_error, kept.systematic, kept.samples
        if not kept.valid.all():
            at = listed(stack.wavelength_nm[~kept.valid])
            notes.append(f"ledger: reweighting leaves too few samples at {at} nm; use 'walk expected'")
        valid = valid & kept.valid
        notes += kept.notes
    else:
        value, random, systematic, samples = _run(stack, view, picked)
        notes += picked.walks.notes() if picked.walks is not None else []
    systematic = np.where(valid, systematic, np.nan)
    target = accuracy.target(value)
    short = np.zeros(len(value), dtype=bool) if target is None else np.hypot(random, systematic) > target * (1 + 1e-9)
    if short.any():
        notes.append(f"the wish ({accuracy.text}) was not met at {listed(stack.wavelength_nm[short])} nm")

    def column(values: FloatArray | NDArray[np.bool_], **about: str) -> xr.DataArray:
        x = {"wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"})}
        return xr.DataArray(values, coords=x, dims="wavelength", attrs=about)

    return Estimate(
        column(value, units="1"),
        column(random, units="1"),
        column(systematic, units="1"),
        clock() - started,
        samples,
        column(valid),
        picked.solver,
        tuple(dict.fromkeys([*stack.notes, *notes])),
    )


def _run(stack: OpticalStack, view: Readout, picked: Picked) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Value, random error, bound of the systematic error, samples."""
    zero = np.zeros(len(stack.wavelength_nm))
    if picked.walks is not None:
        picked.walks.go()
        walks = picked.walks
        return walks.value(), walks.error(), walks.systematic("value"), int(walks.samples.sum())
    if picked.solver == "kubelka-munk":
        value = kubelka_munk_value(stack, view)
        return value, zero, KUBELKA_MUNK_BOUND * value, 0
    if picked.solver == "diffusion":
        value = diffusion_value(stack, view)
        return value, zero, (DIFFUSION_RING_BOUND if view.tally.radius_edges else DIFFUSION_BOUND) * value, 0
    from livlab.model.transport.adding_doubling import adding_doubling

    mu0, tolerance = math.cos(view.source.angle_rad), picked.tolerance or 1e-6
    solved = adding_doubling(stack, mu0=mu0, tolerance=tolerance, mu_min=view.mu_min)
    return view.of_endless(solved), zero, view.error_of_endless(solved), 0
