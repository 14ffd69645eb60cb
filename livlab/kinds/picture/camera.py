"""A virtual camera before a body of tissue: the scene of a picture experiment, exposed pass by pass."""

from __future__ import annotations

import time
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from livlab.kinds.picture.config import PictureExperiment
from livlab.kinds.picture.film import CameraFilm
from livlab.kinds.picture.scene import OUTER, BodySurfaces, body_mesh, check_layering, furnish, nested_stack, surfaces
from livlab.model.shapes import creased, distance_field
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tracer import stage
from livlab.model.tracer.baselines.models import BaselineName, render_baseline
from livlab.model.tracer.baselines.optics import baseline_optics
from livlab.model.tracer.body import Body
from livlab.model.tracer.tracer import Tracer
from livlab.model.tracer.variant import mitsuba
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.model.shapes import DistanceField

LIT = 0.2
"""A pixel is lit where a white body would show this share of what its bright parts (95 of 100 pixels below) show."""

BATCHES = 32
"""Batches of a picture, at least: what its errors are told from is then itself known to an eighth."""

MASK_SPP = 32
MONO = "llvm_ad_mono"
VARIANTS = {"llvm": "llvm_ad_spectral", "cuda": "cuda_ad_spectral"}
FINEST_MM, CELLS = 0.25, 200
"""Grid of the distance field: the body's extent over `CELLS`, not finer than this."""


class PictureCamera:
    """What takes the pictures of an experiment.

    Parameters
    ----------
    config
        A resolved experiment.

    Raises
    ------
    InputError
        A mesh that is no closed surface, or a cut that the layering cannot tell from the surface.
    """

    def __init__(self, config: PictureExperiment) -> None:
        check_layering(config)
        self.config = config
        self.variant = VARIANTS[config.sampling.variant]
        self.whole = body_mesh(config)
        self.nested = config.geometry.layering == "nested"
        self._surfaces: dict[Any, BodySurfaces] = {}
        self._scenes: dict[Any, Any] = {}
        self._ready: tuple[OpticalStack, Tracer] | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What a report must say of the scene as far as it is built."""
        told = [note for made in self._surfaces.values() for note in made.notes]
        if self.nested:
            told.append("Two nested meshes tell two layers: those above the last are one layer of their mean.")
        return tuple(dict.fromkeys(told))

    @cached_property
    def distances(self) -> DistanceField:
        """Distance to the uncut surface."""
        return distance_field(self.whole, max(FINEST_MM, float(self.whole.extent.max()) / CELLS))

    @cached_property
    def _white(self) -> tuple[FloatArray, FloatArray]:
        mi = mitsuba(self.variant)
        outer = next((s.meshes[OUTER] for s in self._surfaces.values()), None)
        if outer is None:
            outer = self.whole
        return stage.white_body(mi, furnish(mi, self.config), {OUTER: outer}, spp=MASK_SPP, seed=self.config.seed)

    @property
    def lit(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(row, column) pixels that see nothing but the body, where the scene's lights reach it."""
        radiance, share = self._white
        filled = share >= 1.0
        if not filled.any():
            return filled
        return np.asarray(filled & (radiance >= LIT * float(np.percentile(radiance[filled], 95))))

    @cached_property
    def _lit_pixels(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        return np.flatnonzero(self.lit)

    def expose(self, film: CameraFilm, stack: OpticalStack, *, spp: int, seed: int) -> None:
        """Add one pass to a film.

        Parameters
        ----------
        film
            At the stack's wavelengths.
        stack
            The tissue.
        spp
            Samples a pixel.
        seed
            Of the picture; what a pass draws follows from it and from the film's number of passes.
        """
        started = time.perf_counter()
        tracer = self._tracer(stack)
        film.setup_seconds += time.perf_counter() - started
        compiled, troubles = tracer.compile_seconds, dict(tracer.troubles)
        tracer.take_given_up()
        left = max(1, spp // film.batch)
        while left:
            batches = min(left, tracer.most_rows())
            seen = np.array(tracer.film(batches, film.batch, seed, film.passes))
            add(film, seen, batches, tracer.padded, self._lit_pixels)
            left -= batches
        film.compile_seconds += tracer.compile_seconds - compiled
        _keep_given_up(film, tracer)
        for name, count in tracer.troubles.items():
            film.about[name] = int(film.about.get(name, 0)) + count - troubles[name]
        film.about["renderer"] = self.variant
        film.seconds += time.perf_counter() - started

    def batch(self, spp: int) -> int:
        """Samples of a batch, for a picture of so many samples a pixel."""
        return max(k for k in range(1, max(1, spp // BATCHES) + 1) if spp % k == 0)

    def baseline(self, name: str, stack: OpticalStack, *, spp: int, seed: int) -> FloatArray:
        """(row, column, W) the scene with an older model in the tissue's place."""
        outer = BodySurfaces({OUTER: self._made(nested_stack(stack) if self.nested else stack).meshes[OUTER]})
        found = render_baseline(
            self._scene(outer, MONO),
            OUTER,
            cast("BaselineName", name),
            baseline_optics(stack),
            spp=max(2, spp),
            seed=seed,
            hide_lights=False,
            variant=MONO,
        )
        return np.asarray(found["radiance"].transpose("row", "column", "wavelength").to_numpy(), dtype=np.float64)

    def _tracer(self, stack: OpticalStack) -> Tracer:
        """The scene made ready for a tissue; the last one is kept."""
        if self._ready is None or self._ready[0] is not stack:
            used = nested_stack(stack) if self.nested else stack
            found = self._made(used)
            names = tuple(found.meshes)
            body = Body(used, names) if self.nested else Body(used, names, self.distances)
            tracer = Tracer(
                self._scene(found, self.variant),
                used.wavelength_nm,
                body,
                estimator=self.config.sampling.estimator,
                variant=self.variant,
            )
            self._ready = (stack, tracer)
        return self._ready[1]

    def _made(self, stack: OpticalStack) -> BodySurfaces:
        key = tuple(x.thickness_mm for x in stack.layers) if self.nested else ()
        if key not in self._surfaces:
            self._surfaces[key] = surfaces(self.config, self.whole, stack)
        return self._surfaces[key]

    def _scene(self, found: BodySurfaces, variant: str) -> Any:
        """The scene for Mitsuba, loaded once a variant and set of surfaces."""
        key = (variant, tuple(m.digest for m in found.meshes.values()))
        mi = mitsuba(variant)
        if key not in self._scenes:
            # A cut has edges, which interpolated normals would round.
            sharp = self.config.geometry.cut is not None
            shapes = {n: stage.surface(mi, creased(m) if sharp else m) for n, m in found.meshes.items()}
            self._scenes[key] = mi.load_dict({"type": "scene", **furnish(mi, self.config), **shapes}, optimize=False)
        return self._scenes[key]


def _keep_given_up(film: CameraFilm, tracer: Tracer) -> None:
    """Add to a film what its last pass gave up."""
    taken = tracer.take_given_up()
    if taken.paths and film.given_up is not None:
        film.given_up.add(taken)
    elif taken.paths:
        film.given_up, film.level = taken, tracer.level


def add(film: CameraFilm, seen: Any, batches: int, padded: int, lit: np.ndarray[Any, np.dtype[np.intp]]) -> None:
    """Add what a launch saw: (batch · pixel · padded wavelength) sums over each batch.

    Parameters
    ----------
    lit
        Numbers of the pixels whose mean spectrum is kept for each batch.
    """
    rows, columns, waves = film.total.shape
    for batch in np.asarray(seen, dtype=np.float32).reshape(batches, rows, columns, padded):
        mean = batch[:, :, :waves] * np.float32(1.0 / film.batch)
        film.total += mean
        film.square += np.square(mean, dtype=np.float64)
        own = mean.reshape(-1, waves)[lit]
        film.spectra.append(own.mean(axis=0, dtype=np.float64) if len(lit) else np.full(waves, np.nan))
    film.batches += batches
    film.passes += 1
