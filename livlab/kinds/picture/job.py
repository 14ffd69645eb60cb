"""The picture job: tissue → optical stack → camera → colour → tables and claims, one picture after the other."""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from livlab.kinds.picture import tables
from livlab.kinds.picture.claims import Key, PictureSummary, judge
from livlab.kinds.picture.colour import colour_routes, mean_colour
from livlab.kinds.picture.config import PictureExperiment
from livlab.kinds.picture.files import label, preview, tables_of, write_pictures
from livlab.kinds.picture.film import CameraFilm
from livlab.kinds.picture.plan import plan_picture
from livlab.kinds.picture.work import Photographer, Work
from livlab.kinds.shared.seeds import reading_seed
from livlab.machine.gpu import name_device
from livlab.model.colour import colour_error
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.stack import OpticalStack
from livlab.runs.work import PieceUnderWay, Run
from livlab.units import FloatArray

SAVE_EVERY_SECONDS = 10.0
"""A picture under way is saved this often at most, and the preview written anew."""

SAVE_SHARE = 0.05
"""Saving large sums takes time: never more than this share of a picture's."""


WATCHED_PIXELS = 20_000
"""Pixels of the lit body whose error is followed while a picture is taken; at its end all count."""


def prepare(
    config: PictureExperiment, make_camera: Callable[[PictureExperiment], Photographer] | None = None
) -> Callable[[Run], None]:
    """Everything that can go wrong before light is followed: datasets, ranges, tissues, the body's mesh.

    Parameters
    ----------
    config
        A resolved experiment.
    make_camera
        Gives what takes an experiment's pictures; `livlab.kinds.picture.camera.PictureCamera` if not said.

    Returns
    -------
    The job: called with the run, it takes the pictures and writes the run's files.

    Raises
    ------
    RangeError
        A wavelength outside the range of a dataset of the tissue (`outside = "hold"` on the spectrum holds its end).
    InputError, DatasetError
        Colour routes, datasets, meshes or layers that do not fit.
    """
    make = make_camera or _camera
    grid, routes = colour_routes(config.colour, config.seed)
    work = Work(config, grid, routes, {}, {}, {}, make(config), make)
    fine = np.arange(np.ceil(grid[0] / 5) * 5, grid[-1] + 1e-9, 5.0)
    for name, spec in config.tissues.items():
        tissue = spec.build()
        for reading in config.all_readings:
            key = (name, reading.name)
            started = time.perf_counter()
            work.stacks[key] = optical_stack(tissue, reading, grid)
            work.curves[key] = optical_stack(tissue, reading, fine)
            work.costs.append(
                {"stage": "tissue", "tissue": name, "reading": reading.name, "seconds": time.perf_counter() - started}
            )
            if config.effects is not None:
                started = time.perf_counter()
                work.plans[key] = plan_picture(config, tissue, reading, work.stacks[key])
                about = {"stage": "plan", "tissue": name, "reading": reading.name}
                work.costs.append({**about, "seconds": time.perf_counter() - started})
    return lambda run: _work(run, work)


def _camera(config: PictureExperiment) -> Photographer:
    from livlab.kinds.picture.camera import PictureCamera

    return PictureCamera(config)


def _work(run: Run, work: Work) -> None:
    config = work.config
    name_device(run.info, config.sampling.variant)
    keys = list(work.stacks)
    tasks = [label(key) for key in keys] + (["baselines"] if config.baselines else [])
    run.progress.begin([*tasks, *(["cost"] if config.cost else [])])
    _note(run, work)
    films: dict[Key, CameraFilm] = {}
    for key in keys:
        stack = work.stacks[key]
        if key in work.plans:
            stack = work.plans[key].stack
            if work.plans[key].told:
                run.note(f"{label(key)}: {work.plans[key].told}")
        films[key] = _picture(run, work, key, stack)
        for text in films[key].notes:
            run.note(f"{label(key)}: {text}")
    for note in work.camera.notes:
        run.note(note)
    baselines = _baselines(run, work)
    started = time.perf_counter()
    pictures = {key: _seen(work, key, film) for key, film in films.items()}
    _doubt(run, work, pictures)
    claims = judge(config, pictures)
    write_pictures(run, work, films, baselines)
    if config.cost is not None:
        from livlab.kinds.picture.cost import study

        study(run, work)
    work.costs.append({"stage": "colour, claims and files", "seconds": time.perf_counter() - started})
    run.finish(claims, tables_of(work, films, pictures), (tables.COSTS, work.costs))


def _note(run: Run, work: Work) -> None:
    """Warnings of the stacks; what several pictures share is said once."""
    by_text: dict[str, list[str]] = {}
    for key, stack in work.stacks.items():
        for text in stack.notes:
            by_text.setdefault(text, []).append(label(key))
    for text, names in by_text.items():
        run.note(text if len(names) == len(work.stacks) > 1 else f"{'; '.join(names)}: {text}")


def _picture(run: Run, work: Work, key: Key, stack: OpticalStack) -> CameraFilm:
    """One picture: as an earlier call left it, gone on from there, or from the start."""
    config, task = work.config, label(key)
    kept = PieceUnderWay(
        run,
        f"picture {task}",
        every_seconds=SAVE_EVERY_SECONDS,
        most_share=SAVE_SHARE,
        beside=lambda: preview(run, work, film),
    )
    saved = kept.load()
    if saved is None:
        batch = math.gcd(work.camera.batch(config.sampling.spp), config.sampling.pass_spp)
        film = CameraFilm.empty(config.camera.height, config.camera.width, work.grid, batch)
    else:
        film = CameraFilm.from_dataset(saved)
    seed = reading_seed(config.seed, task)
    while (share := _share(work, film)) < 1.0:
        run.progress.advance(task, share, _told(film))
        spp = min(config.sampling.pass_spp, config.sampling.spp - film.samples)
        work.camera.expose(film, stack, spp=spp, seed=seed)
        film.trace.append((film.seconds, float(film.samples), film.relative_error(_thinned(work.camera.lit))))
        kept.step(film.to_dataset)
    if saved is None or film.passes > int(saved.attrs["passes"]):
        kept.keep(film.to_dataset())
    run.progress.advance(task, 1.0, _told(film))
    walked = film.samples * config.camera.width * config.camera.height
    work.costs.append(
        {
            "stage": "picture",
            "tissue": key[0],
            "reading": key[1],
            "seconds": film.seconds,
            "compile_seconds": film.compile_seconds,
            "setup_seconds": film.setup_seconds,
            "spp": film.samples,
            "samples": walked,
            "samples_per_second": walked / max(film.walking_seconds, 1e-9),
            "wavelengths": len(work.grid),
            "relative_error": film.relative_error(work.camera.lit),
            "memory_gib": peak_memory_gib(),
        }
    )
    return film


def _thinned(lit: np.ndarray[Any, np.dtype[np.bool_]]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Every so many of the lit pixels, so that looking at the error costs little."""
    found = np.flatnonzero(lit)
    kept = np.zeros_like(lit)
    kept.flat[found[:: max(1, len(found) // WATCHED_PIXELS)]] = True
    return kept


def _share(work: Work, film: CameraFilm) -> float:
    """How far a picture is, 0 to 1: by its samples, and by what it was wished to be worth."""
    share = film.samples / work.config.sampling.spp
    wish = work.config.accuracy
    if wish is None or not film.trace:
        return share
    if wish.seconds is not None:
        return max(share, film.seconds / wish.seconds)
    assert wish.relative is not None
    error = film.trace[-1][2]
    if not (np.isfinite(error) and error > 0):
        return share
    reached = (wish.relative / error) ** 2
    return max(share, 1.0 if reached >= 1.0 else min(reached, 0.999))


def _told(film: CameraFilm) -> str:
    error = film.trace[-1][2] if film.trace else float("nan")
    return f"{film.samples} spp" + (f", error {100 * error:.1f} %" if np.isfinite(error) else "")


def _baselines(run: Run, work: Work) -> dict[str, FloatArray]:
    """The older models, with the numbers that the first reading gives them."""
    config = work.config
    made: dict[str, FloatArray] = {}
    if not config.baselines:
        return made
    stack = work.stacks["", config.all_readings[0].name]
    for k, name in enumerate(config.baselines):
        run.progress.advance("baselines", k / len(config.baselines), name)
        began = time.perf_counter()
        made[name] = work.camera.baseline(name, stack, spp=config.sampling.spp, seed=reading_seed(config.seed, name))
        work.costs.append({"stage": f"baseline {name}", "seconds": time.perf_counter() - began})
        run.stop_if_asked()
    run.progress.advance("baselines", 1.0)
    return made


def _doubt(run: Run, work: Work, pictures: Mapping[Key, PictureSummary]) -> None:
    """What the CIE's route cannot know of the lit body's mean colour: its band may end early, its steps be wide."""
    route = work.routes.get("cie")
    if route is None:
        return
    how, used = work.config.colour, list(route.indices)
    for key, summary in pictures.items():
        spectrum = how.exposure * summary.colours["cie"].spectrum[used]
        made = xr.DataArray(spectrum, dims="wavelength", coords={"wavelength": work.grid[used]})
        if np.isfinite(spectrum).all() and (told := colour_error(made, how.illuminant, how.observer).attrs["told"]):
            run.note(f"{label(key)}, CIE: {told}")


def _seen(work: Work, key: Key, film: CameraFilm) -> PictureSummary:
    lit, exposure = work.camera.lit, work.config.colour.exposure
    colours = {name: mean_colour(film, route, exposure) for name, route in work.routes.items()}
    speed = film.samples * film.total[:, :, 0].size / max(film.walking_seconds, 1e-9)
    return PictureSummary(colours, film.relative_error(lit), film.seconds, peak_memory_gib(), speed)


def peak_memory_gib() -> float:
    """Most memory that this process has held so far, in GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
