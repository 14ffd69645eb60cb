"""A virtual spectrometer by the reference tracer: the sample is a block in a scene, all wavelengths share its paths."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from livlab.acquire.instruments.base import VirtualInstrument
from livlab.acquire.instruments.solvers import TracerSolver
from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.geometry import Readout
from livlab.model.transport.sampling import BUDGET
from livlab.units import FloatArray

THIN = 1e-4
"""Share of the light that may come through the stack: the tracer's block has an open bottom."""

Told = Callable[[xr.Dataset, float, int, float, float], None]
"""From the result so far, the share done, samples, seconds and seconds left."""


def by_tracer(
    stack: OpticalStack,
    instrument: VirtualInstrument,
    solver: TracerSolver,
    view: Readout,
    variant: str,
    on_round: Told | None = None,
    resume: xr.Dataset | None = None,
) -> xr.Dataset:
    """What an instrument reads over a stack, as `spectrometer.measure` returns it.

    The tracer counts what the instrument reads, not where all other light ends: the budget's parts are NaN.

    Raises
    ------
    InputError
        A stack that lets light through, or an earlier result of another measurement.
    """
    from livlab.model.tracer.block import Block

    specular = _specular(stack, view)
    started = time.perf_counter()
    block = Block(stack, view, solver.estimator, f"{variant}_ad_spectral")
    sums = _Sums(len(stack.wavelength_nm))
    if resume is not None:
        _check(resume, stack, instrument, solver, variant)
        sums.take(resume, view.specular_weight * specular)
    before = float(resume.attrs["seconds"]) if resume is not None else 0.0

    def result() -> xr.Dataset:
        mean, error = sums.mean(), sums.error()
        value = mean + view.specular_weight * specular
        met = sums.needed(solver, value) <= sums.samples
        missing = sums.missing(block.given_up())
        said = [*stack.notes, *view.notes, *_shortfalls(stack, met, missing)]
        out = _dataset(stack, value, error, specular, sums.samples, met)
        out["systematic"] = ("wavelength", missing, {"units": "1", "long_name": "bound of what given-up paths lack"})
        out.attrs = {
            "instrument": instrument.model_dump_json(),
            "solver": solver.model_dump_json(exclude_none=True),
            "notes": "\n".join(said),
            "rung": f"tracer {solver.estimator}",
            "samples": sums.samples,
            "seed": solver.seed,
            "variant": variant,
            "estimator": solver.estimator,
            "seconds": before + time.perf_counter() - started,
            "compile_seconds": block.tracer.compile_seconds,
            "launches": sums.launches,
            "row_paths": sums.each,
            "rows": sums.rows,
        }
        return out

    while True:
        value = sums.mean() + view.specular_weight * specular
        wanted = float(np.max(sums.needed(solver, value)))
        spent = before + time.perf_counter() - started
        late = solver.max_seconds is not None and sums.launches > 0 and spent >= solver.max_seconds
        if sums.samples >= min(wanted, solver.max_samples) or late:
            return result()
        # Launches of one size: their rows weigh alike.
        sums.add(*block.launch(solver.launch, solver.seed, sums.launches))
        if on_round is not None:
            now = result()
            done = min(1.0, sums.samples / max(float(np.max(sums.needed(solver, now["value"].to_numpy()))), 1.0))
            spent = float(now.attrs["seconds"])
            on_round(now, done, sums.samples, spent, spent * (1.0 / max(done, 1e-6) - 1.0))


def _specular(stack: OpticalStack, view: Readout) -> FloatArray:
    """(W,) mirror reflection of the surface; a stack that lets light through is refused."""
    from livlab.model.transport.adding_doubling import adding_doubling

    solved = adding_doubling(stack, mu0=math.cos(view.source.angle_rad), tolerance=1e-4)
    through = float(solved["transmittance"].max())
    if through > THIN:
        raise InputError.of(
            "solver.kind",
            "tracer",
            f"needs a sample that no light gets through; {through:.2g} does",
            "Use 'walk', or a thicker last layer.",
        )
    return np.asarray(solved["specular"].to_numpy())


def _shortfalls(stack: OpticalStack, met: NDArray[np.bool_], missing: FloatArray) -> list[str]:
    """Where the error is larger than asked for, and paths that were given up."""
    said = []
    if not met.all():
        short = ", ".join(f"{x:g}" for x in stack.wavelength_nm[~met])
        said.append(f"wanted standard error not reached at {short} nm")
    if missing.max() > 0.0:
        said.append(
            f"paths were given up before they ended; up to {missing.max():.2g} is missing for it, stated as systematic"
        )
    return said


class _Sums:
    """Sums over rows of paths, all wavelengths together."""

    def __init__(self, wavelengths: int) -> None:
        self.total, self.squares = np.zeros(wavelengths), np.zeros(wavelengths)
        self.rows = self.each = self.launches = 0
        self.taken, self.taken_missing = 0, np.zeros(wavelengths)

    @property
    def samples(self) -> int:
        """Paths so far; each serves every wavelength."""
        return self.rows * self.each

    def add(self, total: FloatArray, squares: FloatArray, rows: int, each: int) -> None:
        """Add a launch."""
        self.total += total
        self.squares += squares
        self.rows += rows
        self.each = each
        self.launches += 1

    def mean(self) -> FloatArray:
        """(W,) reading without the mirror reflection."""
        return self.total / max(self.rows, 1)

    def error(self) -> FloatArray:
        """(W,) its standard error."""
        if self.rows < 2:
            return np.full(len(self.total), np.inf)
        spread = np.maximum(self.squares - self.total**2 / self.rows, 0.0)
        return np.asarray(np.sqrt(spread / (self.rows - 1) / self.rows))

    def missing(self, own: FloatArray) -> FloatArray:
        """(W,) bound of what the mean lacks for paths given up, of which `own` is that of the launches since `take`."""
        since = self.samples - self.taken
        return (self.taken_missing * self.taken + own * since) / max(self.samples, 1)

    def needed(self, solver: TracerSolver, value: FloatArray) -> FloatArray:
        """(W,) paths that the rule asks for, as far as is known."""
        if solver.samples is not None:
            return np.full(len(value), float(solver.samples))
        if not self.rows or not float(value.max()) > 0:
            return np.full(len(value), float(solver.max_samples))
        target = solver.standard_error or (solver.relative or 0.0) * float(value.max())
        return np.where(self.error() <= target * (1 + 1e-9), 0.0, self.samples * np.square(self.error() / target) + 1.0)

    def take(self, earlier: xr.Dataset, mirrored: FloatArray) -> None:
        """Go on from an earlier result."""
        self.rows, self.each = int(earlier.attrs["rows"]), int(earlier.attrs["row_paths"])
        self.launches = int(earlier.attrs["launches"])
        self.total = (earlier["value"].to_numpy() - mirrored) * self.rows
        error = earlier["standard_error"].to_numpy()
        self.squares = error**2 * self.rows * (self.rows - 1) + self.total**2 / self.rows
        if "systematic" in earlier:
            self.taken, self.taken_missing = self.samples, earlier["systematic"].to_numpy()


def _check(
    earlier: xr.Dataset, stack: OpticalStack, instrument: VirtualInstrument, solver: TracerSolver, variant: str
) -> None:
    same: dict[str, Any] = {"instrument": instrument.model_dump_json(), "seed": solver.seed, "variant": variant}
    same |= {"estimator": solver.estimator, "rung": f"tracer {solver.estimator}"}
    for key, own in same.items():
        if earlier.attrs.get(key) != own:
            raise InputError.of(
                f"resume: {key}", earlier.attrs.get(key), f"is not this measurement's ({own})", "Start anew."
            )
    layers = [x.name for x in stack.layers]
    if (
        not np.array_equal(earlier["wavelength"].to_numpy(), stack.wavelength_nm)
        or list(earlier["layer"].to_numpy()) != layers
    ):
        raise InputError.of("resume", "other wavelengths or layers", "is not this measurement's", "Start anew.")


def _dataset(
    stack: OpticalStack, value: FloatArray, error: FloatArray, specular: FloatArray, samples: int, met: Any
) -> xr.Dataset:
    unit, w = {"units": "1"}, len(stack.wavelength_nm)
    out = xr.Dataset(
        coords={
            "wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"}),
            "layer": [x.name for x in stack.layers],
        }
    )
    out["value"] = ("wavelength", value, unit)
    out["standard_error"] = ("wavelength", error, unit)
    out["samples"] = ("wavelength", np.full(w, samples, dtype=np.int64))
    out["converged"] = ("wavelength", met)
    out["unfinished"] = ("wavelength", np.zeros(w, dtype=np.int64))
    out["specular"] = ("wavelength", specular, unit)
    out["specular_se"], out["specular_systematic"] = (("wavelength", np.zeros(w), unit) for _ in range(2))
    for name in BUDGET:
        shape = (w, len(stack.layers)) if name == "absorbed" else (w,)
        dims = ("wavelength", "layer") if name == "absorbed" else ("wavelength",)
        for key in (name, f"{name}_se", f"{name}_systematic"):
            out[key] = (dims, np.full(shape, np.nan), unit)
    return out
