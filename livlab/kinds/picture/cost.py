"""What each way of following light costs on a picture: image error against time, on a small copy of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.effects.config import EffectsConfig
from livlab.kinds.picture.config import PictureExperiment
from livlab.kinds.picture.film import CameraFilm
from livlab.kinds.picture.plan import plan_picture
from livlab.kinds.picture.work import Work
from livlab.kinds.shared.seeds import reading_seed
from livlab.model.tissue.stack import OpticalStack
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.runs.work import Run

COLUMNS = (
    "way", "reading", "spp", "seconds", "error", "typical_error", "stated_error", "mean_difference",
    "mean_difference_se", "pixels", "wavelengths",
)  # fmt: skip

_ESTIMATOR = {"analog": "analog"}
_APART = ("one by one", "analog")


def study(run: Run, work: Work) -> None:
    """Write ways.csv: for every way and number of samples the time and the error of a picture.

    The error is measured, not stated: two pictures with other seeds, √⟨(A − B)²/2⟩ over the lit body's pixels and the
    wavelengths, over the mean radiance. A few very bright pixels can rule it; `typical_error` is what most pixels have,
    from the median of |A − B|. `stated_error` is the first from the pictures' own standard errors. `mean_difference` is
    the way's mean radiance over that of the first way at the same samples, less 1, with its standard error: what a way
    leaves out biases it.
    """
    config = work.config
    assert config.cost is not None
    name = config.cost.reading or config.all_readings[0].name
    stack = work.stacks["", name]
    rows: list[dict[str, object]] = []
    steps = [(way, spp) for way in config.cost.ways for spp in config.cost.spp]
    reference: dict[int, tuple[float, float]] = {}
    for k, (way, spp) in enumerate(steps):
        run.progress.advance("cost", k / len(steps), f"{way}, {spp} spp")
        small = _small(config, way)
        camera = work.make_camera(small)
        used = _stack(small, work, way, name, stack)
        if spp == config.cost.spp[0]:
            _take(camera, small, used, way, 1, reading_seed(config.seed, f"{way} warm"))
        pair = [_take(camera, small, used, way, spp, reading_seed(config.seed, f"{way} {spp} {i}")) for i in (0, 1)]
        lit = camera.lit
        values = [film.radiance[lit] for film, _ in pair]
        mean = float(np.mean(values))
        stated = float(np.sqrt(np.mean([np.mean(film.standard_error[lit] ** 2) for film, _ in pair])))
        mean_error = float(np.std(np.mean(values[0] - values[1], axis=1)) / 2.0 / np.sqrt(lit.sum())) / mean
        if way == config.cost.ways[0]:
            reference[spp] = mean, mean_error
        ratio = mean / reference[spp][0]
        rows.append(
            {
                "way": way,
                "reading": name,
                "spp": spp,
                "seconds": float(np.mean([seconds for _, seconds in pair])),
                "error": image_error(values[0], values[1]),
                "typical_error": typical_error(values[0], values[1]),
                "stated_error": stated / mean,
                "mean_difference": ratio - 1.0,
                "mean_difference_se": ratio * float(np.hypot(mean_error, reference[spp][1])),
                "pixels": int(lit.sum()),
                "wavelengths": len(work.grid),
            }
        )
        run.stop_if_asked()
    run.progress.advance("cost", 1.0)
    run.write_table("ways.csv", COLUMNS, rows)


def image_error(first: FloatArray, second: FloatArray) -> float:
    """Relative error of one of two independent pictures: √⟨(A − B)²/2⟩ over their mean.

    >>> round(image_error(np.array([1.0, 3.0]), np.array([1.0, 3.2])), 4)
    0.0488
    """
    return float(np.sqrt(np.mean((first - second) ** 2) / 2.0) / np.mean([first, second]))


def typical_error(first: FloatArray, second: FloatArray) -> float:
    """Relative error that most pixels have: 1.4826 median |A − B|/√2 over the mean (`image_error` for normal errors).

    >>> round(typical_error(np.array([1.0, 1.0, 1.0]), np.array([1.1, 0.9, 9.0])), 4)
    0.0449
    """
    return float(1.4826 * np.median(np.abs(first - second)) / np.sqrt(2.0) / np.mean([first, second]))


def _small(config: PictureExperiment, way: str) -> PictureExperiment:
    assert config.cost is not None
    width = min(config.cost.width, config.camera.width)
    height = max(1, round(width * config.camera.height / config.camera.width))
    camera = config.camera.model_copy(update={"width": width, "height": height})
    sampling = config.sampling.model_copy(update={"estimator": _ESTIMATOR.get(way, "expected")})
    return config.model_copy(update={"camera": camera, "sampling": sampling})


def _stack(config: PictureExperiment, work: Work, way: str, reading: str, stack: OpticalStack) -> OpticalStack:
    if way != "planned":
        return stack
    asked = config.model_copy(update={"effects": config.effects or EffectsConfig()})
    return plan_picture(asked, config.tissue.build(), work.reading(reading), stack).stack


def _take(
    camera: Any, config: PictureExperiment, stack: OpticalStack, way: str, spp: int, seed: int
) -> tuple[CameraFilm, float]:
    """One picture and the seconds it took, compiling apart."""
    rows, columns = config.camera.height, config.camera.width
    parts = [[k] for k in range(len(stack.wavelength_nm))] if way in _APART else [list(range(len(stack.wavelength_nm)))]
    films, seconds = [], 0.0
    for k, indices in enumerate(parts):
        own = stack.at(indices)
        film = CameraFilm.empty(rows, columns, own.wavelength_nm)
        while film.samples < spp:
            camera.expose(film, own, spp=min(config.sampling.pass_spp, spp - film.samples), seed=seed + k)
        seconds += film.walking_seconds
        films.append(film)
    whole = CameraFilm(
        stack.wavelength_nm,
        np.concatenate([f.total for f in films], axis=2),
        np.concatenate([f.square for f in films], axis=2),
        batches=films[0].batches,
    )
    return whole, seconds
