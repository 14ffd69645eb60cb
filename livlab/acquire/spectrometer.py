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

from livlab.acquire.instruments import (
    AddingDoublingSolver,
    Collinear,
    FibreProbe,
    HyperspectralCamera,
    Instrument,
    IntegratingSphere,
    Solver,
    WalkSolver,
)
from livlab.acquire.readout import Readout, readout
from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.units import FloatArray

BUDGET = ("reflectance", "transmittance", "lost", "redirect_loss", "residual", "absorbed")
"""Where light can end, beside the specular reflection; `absorbed` by layer."""

GROWTH = 8
"""A wavelength's samples grow at most this much at once: its noise is only an estimate yet."""


@dataclass(frozen=True)
class Progress:
    """How far a measurement is: share done, samples and seconds so far, and seconds left by present speed."""

    done: float
    samples: int
    seconds: float
    seconds_left: float


Variant = Literal["llvm", "cuda"]
OnRound = Callable[[xr.Dataset, Progress], None]


def measure(
    stack: OpticalStack,
    instrument: Instrument,
    solver: Solver,
    *,
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
        `Collinear`, `IntegratingSphere`, `FibreProbe` or `HyperspectralCamera`; each says what its value is.
    solver
        `WalkSolver` or `AddingDoublingSolver`.
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
        On `wavelength` in nm: value, standard_error, samples, converged; and, as shares of the incident light
        with standard errors `_se`: reflectance (all that leaves the top, seen or not, without specular),
        specular, transmittance, absorbed (and `layer`), lost (through the sides), redirect_loss, residual.
        Attributes: instrument and solver (JSON), samples, seed, variant, estimator, seconds, compile_seconds,
        launches, notes (one a line).

    Raises
    ------
    InputError
        If adding–doubling is asked for a fibre probe, which needs lateral distances; or `resume` is of another
        measurement.
    """
    view = readout(instrument, stack.n_above)
    if isinstance(solver, AddingDoublingSolver):
        return _by_adding_doubling(stack, instrument, solver, view)
    run = _Walks(stack, instrument, solver, view, variant)
    if resume is not None:
        run.take(resume)
    while (plan := run.plan()) is not None:
        run.launch(*plan)
        if on_round is not None:
            on_round(run.result(), run.progress())
    return run.result()


class _Walks:
    """Sums over photons at each wavelength, and what is still to be sampled."""

    def __init__(
        self,
        stack: OpticalStack,
        instrument: Instrument,
        solver: WalkSolver,
        view: Readout,
        variant: Literal["llvm", "cuda"],
    ) -> None:
        self.stack, self.instrument, self.solver, self.view, self.variant = stack, instrument, solver, view, variant
        w, layers = len(stack.wavelength_nm), len(stack.layers)
        self.samples = np.zeros(w, dtype=np.int64)
        shapes = dict.fromkeys(("value", *BUDGET), (w,)) | {"absorbed": (w, layers)}
        self.total: dict[str, FloatArray] = {name: np.zeros(shape) for name, shape in shapes.items()}
        self.squares: dict[str, FloatArray] = {name: np.zeros(shape) for name, shape in shapes.items()}
        self.specular = np.zeros(w)
        self.unfinished = np.zeros(w, dtype=np.int64)
        self.launches, self.seconds, self.compile_seconds = 0, 0.0, 0.0
        self.notes = [*stack.notes, *view.notes]

    def mean(self, name: str) -> FloatArray:
        return self.total[name] / self._n(name)

    def standard_error(self, name: str) -> FloatArray:
        n = self._n(name)
        spread = np.maximum(self.squares[name] - self.total[name] ** 2 / n, 0.0)
        return np.asarray(np.sqrt(spread / np.maximum(n - 1.0, 1.0) / n))

    def value(self) -> FloatArray:
        return self.mean("value") + self.view.specular_weight * self.specular

    def _n(self, name: str) -> FloatArray:
        n = np.maximum(self.samples, 1).astype(np.float64)
        return n[:, None] if self.total[name].ndim == 2 else n

    def needed(self) -> FloatArray:
        """(W,) samples that each wavelength wants in the end, as far as is known."""
        s = self.solver
        if s.samples is not None:
            return np.full(len(self.samples), float(s.samples))
        # No light seen is no proof of none: a single photon more could have come.
        error = np.maximum(self.standard_error("value"), float(self.view.weights.max()) / np.maximum(self.samples, 1))
        top = float(np.max(self.value()))
        target = s.standard_error if s.standard_error is not None else (s.relative or 0.0) * top
        if target <= 0.0:
            # Nothing at all reached the sensor yet: look on for a while, then give up.
            return np.full(len(self.samples), 64.0 * s.pilot)
        wanted = self.samples * np.square(error / target)
        # A resumed state has been through rounding once.
        met = error <= target * (1.0 + 1e-9)
        return np.where(met, self.samples, np.maximum(np.ceil(1.02 * wanted), self.samples + 1))

    def plan(self) -> tuple[NDArray[np.intp], int] | None:
        """Wavelengths and samples of the next launch; None when all is done."""
        s = self.solver
        if s.max_seconds is not None and self.launches and self.seconds >= s.max_seconds:
            return None
        first = s.pilot if s.samples is None else min(s.pilot, s.samples)
        needed = np.where(self.samples == 0, first, self.needed())
        needed = np.minimum(needed, s.max_samples)
        left = needed - self.samples
        active = np.flatnonzero(left > 0)
        if not active.size:
            return None
        # Those who need about as little as the least go together, so that launches stay few.
        near = left[active][left[active] <= 1.3 * left[active].min()]
        wanted = near.max()
        if s.samples is None:
            wanted = max(wanted, first / 4)
            wanted = min(wanted, max(first, GROWTH * float(self.samples[active].min())))
        room = s.largest_launch // active.size
        if s.max_seconds is not None and self.launches:
            speed = float(self.samples.sum()) / max(self.seconds - self.compile_seconds, 1e-3)
            room = min(room, int(speed * (s.max_seconds - self.seconds) / active.size))
        return active, max(1, min(math.ceil(wanted), max(room, 1)))

    def launch(self, active: NDArray[np.intp], samples: int) -> None:
        """Walk `samples` photons at each of some wavelengths, and add them up."""
        from livlab.model.transport.walk import walk

        started = time.perf_counter()
        part = walk(
            self.stack.at(active.tolist()),
            source=self.view.source,
            tally=self.view.tally,
            samples=samples,
            seed=_seed(self.solver.seed, self.launches),
            estimator=self.solver.estimator,
            half_width_mm=self.view.half_width_mm,
            variant=self.variant,
        )
        for name in BUDGET:
            self._add(name, active, samples, part[name].to_numpy(), part[f"{name}_se"].to_numpy())
        self._add_value(active, samples, part)
        self.specular[active] = part["specular"].to_numpy()
        self.unfinished[active] += part["unfinished"].to_numpy()
        self.samples[active] += samples
        self.launches += 1
        self.seconds += time.perf_counter() - started
        self.compile_seconds += float(part.attrs["compile_seconds"])

    def _add(self, name: str, at: Any, samples: int, mean: FloatArray, error: FloatArray) -> None:
        self.total[name][at] += samples * mean
        self.squares[name][at] += samples * np.square(mean) + np.square(error) * (samples - 1.0) * samples

    def _add_value(self, at: NDArray[np.intp], samples: int, part: xr.Dataset) -> None:
        binned = self.view.tally.binned
        mean, error = (
            part[("reflectance_binned" if binned else "reflectance") + end].to_numpy() for end in ("", "_se")
        )
        squares = samples * np.square(mean) + np.square(error) * (samples - 1.0) * samples
        if not binned:
            mean, squares = mean[:, None, None], squares[:, None, None]
        # A photon leaves once, so it is in one bin: the squares of the weighted sum add without cross terms.
        self.total["value"][at] += samples * np.einsum("wtr,tr->w", mean, self.view.weights)
        self.squares["value"][at] += np.einsum("wtr,tr->w", squares, np.square(self.view.weights))

    def take(self, earlier: xr.Dataset) -> None:
        """Go on from an earlier result."""
        same = {"instrument": self.instrument.model_dump_json(), "seed": self.solver.seed, "variant": self.variant}
        same |= {"estimator": self.solver.estimator}
        for key, own in same.items():
            if earlier.attrs.get(key) != own:
                raise InputError.of(
                    f"resume: {key}", earlier.attrs.get(key), f"is not this measurement's ({own})", "Start anew."
                )
        if not np.array_equal(earlier["wavelength"].to_numpy(), self.stack.wavelength_nm) or list(
            earlier["layer"].to_numpy()
        ) != [x.name for x in self.stack.layers]:
            raise InputError.of("resume", "other wavelengths or layers", "is not this measurement's", "Start anew.")
        self.samples = earlier["samples"].to_numpy().astype(np.int64)
        self.specular = earlier["specular"].to_numpy().copy()
        self.unfinished = earlier["unfinished"].to_numpy().astype(np.int64)
        everywhere = slice(None)
        for name in BUDGET:
            n: Any = self._n(name)
            self._add(name, everywhere, n, earlier[name].to_numpy(), earlier[f"{name}_se"].to_numpy())
        scattered = earlier["value"].to_numpy() - self.view.specular_weight * self.specular
        n = self._n("value")
        self._add("value", everywhere, n, scattered, earlier["standard_error"].to_numpy())
        for name in ("launches", "seconds", "compile_seconds"):
            setattr(self, name, earlier.attrs[name])

    def converged(self) -> NDArray[np.bool_]:
        """(W,) whether each wavelength has all it needs."""
        blind = self.solver.relative is not None and float(np.max(self.value())) <= 0.0
        return np.asarray((self.samples > 0) & (self.samples >= self.needed()) & (not blind))

    def progress(self) -> Progress:
        """Share done by samples, and the time left at the mean speed so far."""
        wanted = np.maximum(np.minimum(self.needed(), self.solver.max_samples), self.samples).sum()
        have = int(self.samples.sum())
        done = have / float(wanted)
        walking = max(self.seconds - self.compile_seconds, 0.0)
        left = walking * (1.0 / done - 1.0)
        if self.solver.max_seconds is not None:
            left = min(left, max(self.solver.max_seconds - self.seconds, 0.0))
        return Progress(done, have, self.seconds, left)

    def result(self) -> xr.Dataset:
        """What is known so far."""
        errors = {name: self.standard_error(name) for name in ("value", *BUDGET)}
        values = {name: self.mean(name) for name in BUDGET} | {"value": self.value(), "specular": self.specular}
        errors["specular"] = np.zeros_like(self.specular)
        converged = self.converged()
        notes = list(self.notes)
        if not converged.all():
            short = ", ".join(f"{x:g}" for x in self.stack.wavelength_nm[~converged])
            notes.append(f"wanted standard error not reached at {short} nm")
        if self.unfinished.any():
            notes.append(f"{int(self.unfinished.sum())} photons were given up before they ended; see residual")
        out = _dataset(self.stack, values, errors, self.samples, converged)
        out["unfinished"] = ("wavelength", self.unfinished.copy())
        out.attrs = _attributes(self.instrument, self.solver, notes) | {
            "samples": int(self.samples.sum()),
            "seed": self.solver.seed,
            "variant": self.variant,
            "estimator": self.solver.estimator,
            "seconds": self.seconds,
            "compile_seconds": self.compile_seconds,
            "launches": self.launches,
        }
        return out


def _seed(seed: int, launch: int) -> int:
    return int(np.random.SeedSequence([seed, launch]).generate_state(1)[0] >> 1)


def _by_adding_doubling(
    stack: OpticalStack, instrument: Instrument, solver: AddingDoublingSolver, view: Readout
) -> xr.Dataset:
    from livlab.model.transport.adding_doubling import adding_doubling

    notes = _lateral_notes(instrument)
    started = time.perf_counter()
    mu0 = math.cos(view.source.angle_rad)
    solved = adding_doubling(stack, mu0=mu0, tolerance=solver.tolerance)
    specular = solved["specular"].to_numpy()
    zero = np.zeros_like(specular)
    values = {name: solved[name].to_numpy() for name in ("reflectance", "specular", "transmittance", "absorbed")}
    values |= {"lost": zero, "redirect_loss": zero, "residual": solved["residual"].to_numpy()}
    values["value"] = view.of_endless(solved)
    errors = {name: np.zeros_like(array) for name, array in values.items()}
    converged = np.asarray(solved["converged"].to_numpy(), dtype=bool)
    out = _dataset(stack, values, errors, np.zeros(len(specular), dtype=np.int64), converged)
    out["error_estimate"] = ("wavelength", solved["error_estimate"].to_numpy(), {"units": "1"})
    out["unfinished"] = ("wavelength", np.zeros(len(specular), dtype=np.int64))
    more = solved.attrs.get("notes", ())
    notes = [*dict.fromkeys([*stack.notes, *([more] if isinstance(more, str) else more), *notes, *view.notes])]
    out.attrs = _attributes(instrument, solver, notes) | {
        "samples": 0,
        "seed": 0,
        "variant": "none",
        "estimator": "none",
        "seconds": time.perf_counter() - started,
        "compile_seconds": 0.0,
        "launches": 0,
    }
    return out


def _lateral_notes(instrument: Instrument) -> list[str]:
    if isinstance(instrument, FibreProbe):
        raise InputError.of(
            "solver.kind", "adding-doubling", "knows no lateral distance, which a fibre probe needs", "Use 'walk'."
        )
    notes = []
    if isinstance(instrument, Collinear | IntegratingSphere) and instrument.sample_side_mm != "infinite":
        notes.append(
            f"adding-doubling takes the sample of {instrument.sample_side_mm:g} mm as endless: nothing is lost sideways"
        )
    if isinstance(instrument, IntegratingSphere) and instrument.port_diameter_mm != "infinite":
        notes.append(
            f"adding-doubling takes the port of {instrument.port_diameter_mm:g} mm as endless: nothing misses it"
        )
    assert isinstance(instrument, Collinear | IntegratingSphere | HyperspectralCamera)
    return notes


def _dataset(
    stack: OpticalStack,
    values: dict[str, FloatArray],
    errors: dict[str, FloatArray],
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
    out["samples"] = ("wavelength", samples.copy())
    out["converged"] = ("wavelength", converged)
    for name in ("specular", *BUDGET):
        dims = ("wavelength", "layer") if name == "absorbed" else ("wavelength",)
        out[name] = (dims, values[name].copy(), unit)
        out[f"{name}_se"] = (dims, errors[name], unit)
    return out


def _attributes(instrument: Instrument, solver: Solver, notes: list[str]) -> dict[str, Any]:
    return {
        "instrument": instrument.model_dump_json(),
        "solver": solver.model_dump_json(exclude_none=True),
        "notes": "\n".join(notes),
    }
