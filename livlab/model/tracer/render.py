"""Pictures of a scene with a body of tissue, at any number of wavelengths, with the error of every pixel."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tracer.body import Body
from livlab.model.tracer.context import MAX_BOUNCES
from livlab.model.tracer.film import Film, row_samples
from livlab.model.tracer.tracer import VARIANT, Tracer
from livlab.model.transport.accuracy import Accuracy
from livlab.units import FloatArray

MOST_SPP = 1 << 20
"""Samples a pixel after which an accuracy that is not met is given up."""

LAUNCH_PATHS = 1 << 22
"""Paths of a launch, the grain of progress: a few seconds of work."""

_KEPT = 2


@dataclass(frozen=True)
class RenderProgress:
    """How far a picture is.

    Attributes
    ----------
    done
        Share of the samples; with an accuracy, of those it seems to need.
    samples
        A pixel so far.
    seconds, seconds_left
        Spent, and left at the present speed.
    error
        Median over the body's pixels and the wavelengths of the error relative to the radiance; NaN if unknown.
    """

    done: float
    samples: int
    seconds: float
    seconds_left: float
    error: float


def render(
    scene: Mapping[str, Any] | Any,
    wavelengths_nm: Sequence[float] | FloatArray,
    *,
    body: Body | None = None,
    spp: int | None = None,
    seed: int = 0,
    accuracy: Accuracy | None = None,
    estimator: str = "expected",
    together: bool = True,
    sensor: int = 0,
    variant: str = VARIANT,
    max_steps: int = 100_000,
    max_bounces: int = MAX_BOUNCES,
    progress: Callable[[RenderProgress], None] | None = None,
    preview: Callable[[xr.Dataset], None] | None = None,
    checkpoint: Callable[[xr.Dataset], None] | None = None,
    resume: xr.Dataset | None = None,
) -> xr.Dataset:
    """Radiance that a camera sees, with its standard error.

    Parameters
    ----------
    scene
        A scene as `mitsuba.load_dict` takes it, or a loaded one of the same variant. The body's surfaces are shapes
        of it, named by their keys; their BSDF is not used.
    wavelengths_nm
        (W,) wavelengths; those of the body's stack.
    body
        The tissue; None: a scene without.
    spp
        Samples a pixel, each of which serves all wavelengths. Default 16, or as many as `accuracy` needs.
    seed
        Natural number; in one process the same seed gives the same picture to the last bit. So it did in every process
        on one machine that was tried but for one case, whose cause is not known: see docs/tracer.md.
    accuracy
        Stop when the median over the body's pixels and all wavelengths of the standard error meets it, relative to
        the radiance or as it is; or when the time is up. `spp` then is the most.
    estimator
        "expected": a path's first collision in an absorbing layer is survived by weight, and Algorithm 2's factor is
        its mean. "analog": absorption ends a path, the factor is drawn.
    together
        Whether a path serves all wavelengths; if not, each is rendered for itself.
    sensor
        Which of the scene's cameras.
    variant
        A spectral variant of Mitsuba: "llvm_ad_spectral" or "cuda_ad_spectral".
    max_steps, max_bounces
        Steps, and objects hit, after which a path is given up (counted in the attribute `given_up`). What it still
        weighed goes into `systematic`.
    progress, preview
        Called after each launch with how far it is, and with the picture so far.
    checkpoint
        Called after each launch with all there is to go on from.
    resume
        What `checkpoint` was given: the picture ends as it would have without the interruption.

    Returns
    -------
    xr.Dataset
        `radiance`, its standard error `radiance_se` and `systematic`, a bound of the radiance that given-up paths would
        have brought (`given_up.GivenUp.systematic`; infinite where the light does not fade), on (row, column,
        wavelength). Attributes: samples, seed, variant, estimator, seconds, compile_seconds, finished (False after
        Ctrl-C, which keeps what is done), given_up (paths), strayed (paths found outside that no ray had seen leave:
        they go on from there, nothing is lost), notes (one a line).

    Raises
    ------
    InputError
        An argument out of its bounds, or a resumed state of another picture.
    EnvironmentProblem
        The variant cannot run here.
    """
    grid = np.asarray(wavelengths_nm, dtype=np.float64)
    _check(spp, seed)
    settings = {"sensor": sensor, "estimator": estimator, "variant": variant}
    settings |= {"max_steps": max_steps, "max_bounces": max_bounces}
    if not together and len(grid) > 1:
        if resume is not None or checkpoint is not None:
            raise InputError.of("together", together, "pictures one by one keep no state", "Render them together.")
        return _one_by_one(scene, grid, body, settings, spp=spp, seed=seed, accuracy=accuracy)
    tracer = ready(scene, grid, body, **settings)
    most = spp or (16 if accuracy is None else MOST_SPP)
    film = Film(tracer.shape, tracer.wavelengths, row_samples(most))
    tracer.take_given_up()
    if resume is not None:
        _resume(film, resume, seed)
    seen = tracer.sees_body() if body is not None and (accuracy is not None or progress is not None) else None
    before, compiled, troubles = tracer.seconds, tracer.compile_seconds, dict(tracer.troubles)
    goal = _Goal(most, accuracy, seen)
    finished = _launches(tracer, film, goal, seed, progress=progress, preview=preview, checkpoint=checkpoint)
    out = film.dataset()
    out.attrs = {
        "samples": film.samples,
        "seed": seed,
        "variant": variant,
        "estimator": estimator,
        "seconds": tracer.seconds - before,
        "compile_seconds": tracer.compile_seconds - compiled,
        "finished": finished,
        "notes": "\n".join(
            [
                *(body.stack.notes if body is not None else ()),
                *film.given_up.notes(film.samples * tracer.pixels, film.systematic(), film.mean()),
            ]
        ),
        **{key: value - troubles[key] for key, value in tracer.troubles.items()},
    }
    return out


@dataclass(frozen=True)
class _Goal:
    """When a picture is done.

    Attributes
    ----------
    most
        Samples a pixel at which it is in any case.
    seen
        (row, column) pixels that show the body, whose error counts; None: all.
    """

    most: int
    accuracy: Accuracy | None
    seen: Any

    def met(self, film: Film, seconds: float) -> bool:
        """Whether the wished accuracy is there, or the time up."""
        accuracy, seen = self.accuracy, self.seen
        if accuracy is None or film.rows < 8:
            return False
        if accuracy.seconds is not None:
            return seconds >= accuracy.seconds
        if accuracy.relative is not None:
            return median_error(film, seen) <= accuracy.relative
        error = film.standard_error()
        of = error[seen] if seen is not None and seen.any() else error
        return float(np.median(of)) <= float(accuracy.standard_error or 0.0)

    def progress(self, film: Film, spent: float) -> RenderProgress:
        """How far a film is after so many seconds."""
        samples, accuracy, error = film.samples, self.accuracy, median_error(film, self.seen)
        wanted = float(self.most)
        if accuracy is not None and accuracy.relative is not None and np.isfinite(error):
            wanted = min(wanted, max(samples * (error / accuracy.relative) ** 2, float(samples)))
        done, left = min(samples / wanted, 1.0), max(spent * (wanted / samples - 1.0), 0.0)
        if accuracy is not None and accuracy.seconds is not None:
            done, left = min(spent / accuracy.seconds, 1.0), max(accuracy.seconds - spent, 0.0)
        return RenderProgress(done=done, samples=samples, seconds=spent, seconds_left=left, error=error)


def _launches(
    tracer: Tracer,
    film: Film,
    goal: _Goal,
    seed: int,
    *,
    progress: Callable[[RenderProgress], None] | None,
    preview: Callable[[xr.Dataset], None] | None,
    checkpoint: Callable[[xr.Dataset], None] | None,
) -> bool:
    """Add launches to a film until its goal is met; whether it was, or Ctrl-C came first."""
    started = time.perf_counter()
    try:
        while film.samples < goal.most and not goal.met(film, time.perf_counter() - started):
            per_row = tracer.pixels * film.row_samples
            left = (goal.most - film.samples) // film.row_samples
            rows = max(1, min(tracer.most_rows(), LAUNCH_PATHS // per_row, left))
            film.add(*tracer.launch(rows, film.row_samples, seed, film.passes), rows)
            film.given_up.add(tracer.take_given_up())
            if film.given_up.paths:
                film.level = tracer.level
            if progress is not None:
                progress(goal.progress(film, time.perf_counter() - started))
            if preview is not None:
                preview(film.dataset())
            if checkpoint is not None:
                state = film.state()
                state.attrs["seed"] = seed
                checkpoint(state)
    except KeyboardInterrupt:
        if not film.rows:
            raise
        return False
    return True


def _check(spp: int | None, seed: int) -> None:
    if spp is not None and not 1 <= spp <= MOST_SPP:
        raise InputError.of("spp", spp, f"must be within [1, {MOST_SPP}]", "Ask for that many samples a pixel.")
    if seed < 0:
        raise InputError.of("seed", seed, "must be >= 0", "Give a natural number.")


def _resume(film: Film, state: xr.Dataset, seed: int) -> None:
    """Go on from what a checkpoint was given."""
    if int(state.attrs.get("seed", -1)) != seed:
        raise InputError.of("resume: seed", state.attrs.get("seed"), f"is not {seed}", "Start anew.")
    film.take(state)


_ready: OrderedDict[Any, tuple[Any, Tracer]] = OrderedDict()


def ready(scene: Any, wavelengths: FloatArray, body: Body | None, **settings: Any) -> Tracer:
    """A scene made ready; one that is loaded and comes again is found ready."""
    if isinstance(scene, Mapping):
        return Tracer(scene, wavelengths, body, **settings)
    stack = None if body is None else _digest(body.stack)
    shape = None if body is None else (body.surfaces, id(body.distances), body.mm_per_unit, body.patch_mm)
    key = (id(scene), wavelengths.tobytes(), stack, shape, tuple(sorted(settings.items())))
    if key not in _ready:
        # What the key names by its address must live as long as the key.
        _ready[key] = ((scene, body), Tracer(scene, wavelengths, body, **settings))
        while len(_ready) > _KEPT:
            _ready.popitem(last=False)
    _ready.move_to_end(key)
    return _ready[key][1]


def median_error(film: Film, seen: Any) -> float:
    """Median over pixels (of those `seen`) and wavelengths of the standard error relative to the radiance."""
    if film.rows < 2:
        return float("nan")
    mean, error = film.mean(), film.standard_error()
    where = mean > 0.0
    if seen is not None:
        where &= seen[..., None]
    return float(np.median(error[where] / mean[where])) if where.any() else float("nan")


def _one_by_one(scene: Any, grid: FloatArray, body: Body | None, settings: dict[str, Any], **wishes: Any) -> xr.Dataset:
    parts = []
    for k, wavelength in enumerate(grid):
        alone = None
        if body is not None:
            alone = Body(body.stack.at([k]), body.surfaces, body.distances, body.mm_per_unit, body.patch_mm)
        wishes["seed"] = wishes["seed"] + (1 << 20) * (k > 0)
        parts.append(render(scene, [float(wavelength)], body=alone, **settings, **wishes))
    out = xr.concat(parts, "wavelength").transpose("row", "column", "wavelength")
    notes = dict.fromkeys(line for p in parts for line in p.attrs["notes"].splitlines())
    out.attrs = parts[0].attrs | {
        "notes": "\n".join(notes),
        **{key: sum(p.attrs[key] for p in parts) for key in ("seconds", "compile_seconds", "given_up", "strayed")},
    }
    return out


def _digest(stack: OpticalStack) -> int:
    parts: list[Any] = [stack.wavelength_nm.tobytes(), stack.n_above.tobytes(), stack.n_below.tobytes()]
    for layer in stack.layers:
        parts += [layer.thickness_mm, layer.n.tobytes()]
        for i in layer.interactions:
            parts += [i.rate.tobytes(), i.albedo.tobytes(), i.redirect, i.absorb_below_mm]
            with suppress(TypeError):  # a user's own phase function may not be hashable: then it is told by its address
                parts.append(hash(i.phases))
                continue
            parts.append(tuple(id(p) for p in i.phases))
    return hash(tuple(parts))
