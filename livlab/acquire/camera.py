"""A virtual camera before a body of tissue: the scene of a picture experiment, exposed pass by pass."""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import xarray as xr

from livlab.acquire.camera_film import Film
from livlab.acquire.camera_scene import OUTER, BodySurfaces, body_mesh, check_layering, furnish, nested_stack, surfaces
from livlab.config_picture import PictureExperiment
from livlab.model.shapes import distance_field
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tracer import stage
from livlab.model.tracer.baselines import Name, baseline_optics, render_baseline
from livlab.model.tracer.body import Body
from livlab.model.tracer.render import render
from livlab.model.tracer.variant import mitsuba
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.model.shapes import DistanceField

LIT = 0.2
"""A pixel is lit where a white body would show this share of what its bright parts (95 of 100 pixels below) show."""

MASK_SPP = 32
MONO = "llvm_ad_mono"
VARIANTS = {"llvm": "llvm_ad_spectral", "cuda": "cuda_ad_spectral"}
FINEST_MM, CELLS = 0.25, 200
"""Grid of the distance field: the body's extent over `CELLS`, not finer than this."""


class Camera:
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

    @property
    def notes(self) -> tuple[str, ...]:
        """What a report must say of the scene as far as it is built."""
        told = [note for made in self._surfaces.values() for note in made.notes]
        if self.nested:
            told.append("Two nested meshes tell two layers: the capsule's sublayers are one layer of their mean.")
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

    def expose(self, film: Film, stack: OpticalStack, *, spp: int, seed: int) -> None:
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
            Of the picture; the pass's own follows from it and from the film's number of passes.
        """
        used = nested_stack(stack) if self.nested else stack
        found = self._made(used)
        names = tuple(found.meshes)
        body = Body(used, names) if self.nested else Body(used, names, self.distances)
        out = render(
            self._scene(found, self.variant),
            film.wavelength_nm.tolist(),
            body=body,
            spp=spp,
            seed=pass_seed(seed, film.passes),
            estimator=self.config.sampling.estimator,
            variant=self.variant,
        )
        add(film, out)

    def baseline(self, name: str, stack: OpticalStack, *, spp: int, seed: int) -> FloatArray:
        """(row, column, W) the scene with an older model in the tissue's place."""
        outer = BodySurfaces({OUTER: self._made(nested_stack(stack) if self.nested else stack).meshes[OUTER]})
        found = render_baseline(
            self._scene(outer, MONO),
            OUTER,
            cast("Name", name),
            baseline_optics(stack),
            spp=max(2, spp),
            seed=seed,
            hide_lights=False,
            variant=MONO,
        )
        return np.asarray(found["radiance"].transpose("row", "column", "wavelength").to_numpy(), dtype=np.float64)

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
            smooth = self.config.geometry.cut is None
            shapes = {name: stage.surface(mi, mesh, smooth=smooth) for name, mesh in found.meshes.items()}
            self._scenes[key] = mi.load_dict({"type": "scene", **furnish(mi, self.config), **shapes}, optimize=False)
        return self._scenes[key]


def pass_seed(seed: int, passes: int) -> int:
    """Seed of a pass: far from those of other passes and pictures.

    >>> pass_seed(1, 0) != pass_seed(1, 1) != pass_seed(2, 0)
    True
    """
    return int.from_bytes(hashlib.sha256(f"{seed}:{passes}".encode()).digest()[:4], "big") >> 1


def add(film: Film, out: xr.Dataset) -> None:
    """Add what one rendering saw: mean and standard error over its samples, turned back into sums."""
    n = int(out.attrs["samples"])
    over = ("row", "column", "wavelength")
    mean = out["radiance"].transpose(*over).to_numpy().astype(np.float64)
    error = out["radiance_se"].transpose(*over).to_numpy().astype(np.float64)
    film.total += n * mean
    film.square += n * ((n - 1) * error**2 + mean**2)
    film.samples += n
    film.passes += 1
    film.compile_seconds += float(out.attrs.get("compile_seconds", 0.0))
    film.about["variant"] = str(out.attrs.get("variant", ""))
