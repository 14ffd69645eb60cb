"""A virtual spectrometer over an optical stack: one number a wavelength, with its error and the light's whole account.

A walk is sampled until every wavelength meets the wanted error, each with as many samples as it needs; what was
measured so far is itself the state to go on from.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from livlab.acquire.instruments.base import VirtualInstrument
from livlab.acquire.instruments.solvers import DEFAULT_ACCURACY, AutoSolver, Solver, WalkSolver
from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.accuracy import Accuracy
from livlab.model.transport.device import Variant
from livlab.model.transport.geometry import Readout
from livlab.model.transport.ladder.solve import Estimate, pick, solve
from livlab.model.transport.sampling import BUDGET, SamplingRule, Walks
from livlab.units import FloatArray

__all__ = [
    "BUDGET",
    "Accuracy",
    "Estimate",
    "MeasurementProgress",
    "OnRound",
    "SamplingRule",
    "Variant",
    "estimate",
    "measure",
    "sampling_of",
]


@dataclass(frozen=True)
class MeasurementProgress:
    """How far a measurement is: share done, samples and seconds so far, and seconds left by present speed."""

    done: float
    samples: int
    seconds: float
    seconds_left: float


OnRound = Callable[[xr.Dataset, MeasurementProgress], None]


def measure(
    stack: OpticalStack,
    instrument: VirtualInstrument,
    solver: Solver,
    *,
    accuracy: Accuracy | None = None,
    variant: Variant = "llvm",
    on_round: OnRound | None = None,
    resume: xr.Dataset | None = None,
) -> xr.Dataset:
    """What an instrument reads over a stack.

    Parameters
    ----------
    stack
        The layers and wavelengths.
    instrument
        One of `livlab.acquire.instruments.models.INSTRUMENTS`; each says what its value is.
    solver
        `WalkSolver`, `AddingDoublingSolver`, `TracerSolver`, or `AutoSolver`, which picks the cheaper of the first two.
    accuracy
        The wish that an `AutoSolver` is to meet; `DEFAULT_ACCURACY` if none is given.
    variant
        Where a walk runs.
    on_round
        Called after each launch with the result so far and the progress; what it raises stops the measurement.
    resume
        A result, finished or not, of the same stack, instrument and seed to go on from. Its launches count: the
        resumed walk ends as the uninterrupted one would.

    Returns
    -------
    xr.Dataset
        On `wavelength` in nm: value, standard_error, systematic (bound of its other errors), samples, converged;
        and, as shares of the incident light with standard errors `_se` and bounds `_systematic`: reflectance (all
        that leaves the top, seen or not, without specular), specular, transmittance, absorbed (and `layer`), lost
        (through the sides), redirect_loss, residual.
        Attributes: instrument and solver (JSON), rung, samples, seed, variant, estimator, seconds, compile_seconds,
        launches, notes (one a line); of a walk trace_seconds, trace_samples, trace_error: how its error fell.

    Raises
    ------
    InputError
        If adding–doubling is asked for what needs lateral distances, as a fibre probe does; the tracer for a sample
        that light gets through; or `resume` is of another measurement.
    """
    view = instrument.readout(stack.n_above)
    if solver.kind == "adding-doubling":
        return _by_adding_doubling(stack, instrument, solver, solver.tolerance, view)
    if solver.kind == "tracer":
        from livlab.acquire.instruments.spectrometer_tracer import by_tracer

        def tell(so_far: xr.Dataset, *told: Any) -> None:
            if on_round is not None:
                on_round(so_far, MeasurementProgress(*told))

        return by_tracer(stack, instrument, solver, view, variant, tell, resume)
    rule, walks = sampling_of(solver, accuracy), None
    notes: tuple[str, ...] = ()
    # What is gone on from has been chosen before, and was a walk: nothing else takes rounds.
    if solver.is_auto and resume is None:
        wish = accuracy or DEFAULT_ACCURACY
        picked = pick(stack, view, wish, account=True, sampling=rule, variant=variant)
        walks, notes = picked.walks, picked.notes
        if walks is None:
            solved = _by_adding_doubling(stack, instrument, solver, picked.tolerance or 1e-6, view, notes)
            target = wish.target(solved["value"].to_numpy())
            if target is None or float(solved["error_estimate"].max()) <= target:
                return solved
            notes = (f"auto: walk expected; adding-doubling did not reach an {wish.text}",)
    walks = walks or Walks(stack, view, rule, variant=variant)
    if resume is not None:
        _take(walks, instrument, resume)
    return _by_walk(stack, instrument, solver, walks, notes, on_round)


def estimate(
    stack: OpticalStack,
    instrument: VirtualInstrument,
    accuracy: Accuracy | None = None,
    solver: str = "auto",
    *,
    outside: Literal["refuse", "warn"] = "refuse",
    sampling: SamplingRule | None = None,
    variant: Variant = "llvm",
) -> Estimate:
    """What an instrument reads over a stack by one solver of the ladder: `livlab.model.transport.ladder.solve.solve`.

    >>> from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
    >>> from livlab.model.tissue.phase.functions import Isotropic
    >>> from livlab.model.tissue.stack import plain_stack
    >>> slab = plain_stack([(1.0, 1.0, 99.0, 1.0, Isotropic())])
    >>> estimate(slab, HyperspectralCamera(illumination_deg=0.0), Accuracy(standard_error=1e-3)).solver
    'adding-doubling'
    """
    view = instrument.readout(stack.n_above)
    return solve(stack, view, accuracy, solver, outside=outside, sampling=sampling, variant=variant)


def _by_walk(
    stack: OpticalStack,
    instrument: VirtualInstrument,
    solver: Solver,
    walks: Walks,
    notes: tuple[str, ...],
    on_round: OnRound | None,
) -> xr.Dataset:
    def result() -> xr.Dataset:
        """What is known so far."""
        errors = {name: walks.standard_error(name) for name in ("value", *BUDGET)}
        values = {name: walks.mean(name) for name in BUDGET} | {"value": walks.value(), "specular": walks.specular}
        errors["specular"] = np.zeros_like(walks.specular)
        converged = walks.converged()
        said = [*stack.notes, *walks.view.notes, *notes]
        if not converged.all():
            short = ", ".join(f"{x:g}" for x in stack.wavelength_nm[~converged])
            said.append(f"wanted standard error not reached at {short} nm")
        said += walks.notes()
        bounds = {name: walks.systematic(name) for name in ("value", *BUDGET)} | {"specular": errors["specular"]}
        out = _dataset(stack, values, errors, bounds, walks.samples, converged)
        out["unfinished"] = ("wavelength", walks.unfinished.copy())
        out["unfinished_share"] = ("wavelength", walks.unfinished_share.copy(), {"units": "1"})
        out.attrs = _attributes(instrument, solver, said) | {
            "rung": f"walk {walks.rule.estimator}",
            "samples": int(walks.samples.sum()),
            "seed": walks.rule.seed,
            "variant": walks.variant,
            "estimator": walks.rule.estimator,
            "seconds": walks.seconds,
            "compile_seconds": walks.compile_seconds,
            "launches": walks.launches,
            **walks.trace_attributes(),
        }
        return out

    def tell(_: Walks) -> None:
        if on_round is not None:
            done, left = walks.done()
            on_round(result(), MeasurementProgress(done, int(walks.samples.sum()), walks.seconds, left))

    walks.go(tell)
    return result()


def _take(walks: Walks, instrument: VirtualInstrument, earlier: xr.Dataset) -> None:
    """Go on from an earlier result, if it is of the same measurement."""
    same = {"instrument": instrument.model_dump_json(), "seed": walks.rule.seed, "variant": walks.variant}
    same |= {"estimator": walks.rule.estimator}
    for key, own in same.items():
        if earlier.attrs.get(key) != own:
            raise InputError.of(
                f"resume: {key}", earlier.attrs.get(key), f"is not this measurement's ({own})", "Start anew."
            )
    if not np.array_equal(earlier["wavelength"].to_numpy(), walks.stack.wavelength_nm) or list(
        earlier["layer"].to_numpy()
    ) != [x.name for x in walks.stack.layers]:
        raise InputError.of("resume", "other wavelengths or layers", "is not this measurement's", "Start anew.")
    walks.take(earlier)


def sampling_of(solver: WalkSolver | AutoSolver, accuracy: Accuracy | None = None) -> SamplingRule:
    """What rules a solver's walk; an accuracy replaces the walk's own rule."""
    return SamplingRule(**solver.rule(accuracy))


def _by_adding_doubling(
    stack: OpticalStack,
    instrument: VirtualInstrument,
    solver: Solver,
    tolerance: float,
    view: Readout,
    said: tuple[str, ...] = (),
) -> xr.Dataset:
    from livlab.model.transport.adding_doubling import adding_doubling

    if instrument.lateral_distance:
        raise InputError.of(
            "solver.kind",
            "adding-doubling",
            f"knows no lateral distance, which a {instrument.words} needs",
            "Use 'walk'.",
        )
    notes = instrument.endless_notes()
    started = time.perf_counter()
    mu0 = math.cos(view.source.angle_rad)
    solved = adding_doubling(stack, mu0=mu0, tolerance=tolerance, mu_min=view.mu_min)
    specular = solved["specular"].to_numpy()
    zero = np.zeros_like(specular)
    values = {name: solved[name].to_numpy() for name in ("reflectance", "specular", "transmittance", "absorbed")}
    values |= {"lost": zero, "redirect_loss": zero, "residual": solved["residual"].to_numpy()}
    values["value"] = view.of_endless(solved)
    errors = {name: np.zeros_like(array) for name, array in values.items()}
    bounds = errors | {
        name: solved[f"{name}_error"].to_numpy() for name in ("reflectance", "transmittance", "absorbed")
    }
    bounds["value"] = view.error_of_endless(solved)
    converged = np.asarray(solved["converged"].to_numpy(), dtype=bool)
    out = _dataset(stack, values, errors, bounds, np.zeros(len(specular), dtype=np.int64), converged)
    out["error_estimate"] = ("wavelength", bounds["value"].copy(), {"units": "1"})
    out["unfinished"] = ("wavelength", np.zeros(len(specular), dtype=np.int64))
    out["unfinished_share"] = ("wavelength", zero.copy(), {"units": "1"})
    more = solved.attrs.get("notes", ())
    notes = [*dict.fromkeys([*stack.notes, *([more] if isinstance(more, str) else more), *notes, *view.notes, *said])]
    out.attrs = _attributes(instrument, solver, notes) | {
        "rung": "adding-doubling",
        "samples": 0,
        "seed": 0,
        "variant": "none",
        "estimator": "none",
        "seconds": time.perf_counter() - started,
        "compile_seconds": 0.0,
        "launches": 0,
    }
    return out


def _dataset(
    stack: OpticalStack,
    values: dict[str, FloatArray],
    errors: dict[str, FloatArray],
    bounds: dict[str, FloatArray],
    samples: NDArray[np.int64],
    converged: NDArray[np.bool_],
) -> xr.Dataset:
    out = xr.Dataset(
        coords={
            "wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"}),
            "layer": [x.name for x in stack.layers],
        }
    )
    unit = {"units": "1"}
    out["value"] = ("wavelength", values["value"], unit)
    out["standard_error"] = ("wavelength", errors["value"], unit)
    out["systematic"] = ("wavelength", bounds["value"], unit)
    out["samples"] = ("wavelength", samples.copy())
    out["converged"] = ("wavelength", converged)
    for name in ("specular", *BUDGET):
        dims = ("wavelength", "layer") if name == "absorbed" else ("wavelength",)
        out[name] = (dims, values[name].copy(), unit)
        out[f"{name}_se"] = (dims, errors[name], unit)
        out[f"{name}_systematic"] = (dims, bounds[name], unit)
    return out


def _attributes(instrument: VirtualInstrument, solver: Solver, notes: list[str]) -> dict[str, Any]:
    return {
        "instrument": instrument.model_dump_json(),
        "solver": solver.model_dump_json(exclude_none=True),
        "notes": "\n".join(notes),
    }
