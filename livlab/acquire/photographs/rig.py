"""Photographs of a sphere as `livlab.brdf.sphere.extract` takes them: read and developed one light at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from livlab.acquire.photographs.calibration import CameraCalibration
from livlab.acquire.photographs.calibration_chart import ColourCalibration
from livlab.acquire.photographs.lights import Highlight, lambert_intensities
from livlab.acquire.photographs.linearity import Linearity, from_matte_sphere
from livlab.acquire.photographs.merge import Merged
from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.pose import SpherePose
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.errors import InputError

MOST_SAMPLES = 1_000_000
"""Samples that are kept by default: more know nothing better and take 200 bytes each."""

HIGHLIGHT = float(np.deg2rad(30.0))
"""From the half vector: what a test for linearity leaves out as highlight."""

BESIDE = float(np.deg2rad(25.0))
"""From the camera: a light nearer than that stands beside it."""


class DevelopedFrames:
    """Developed pictures by light; the last one is kept, so that value and variance are developed once.

    Parameters
    ----------
    develop
        Gives the merged picture of a light.
    count, shape
        Lights, and (rows, columns, channels) of each picture.
    """

    def __init__(self, develop: Callable[[int], Merged], count: int, shape: tuple[int, int, int]) -> None:
        self.develop, self.count, self.shape = develop, count, shape
        self.told: dict[int, Merged] = {}
        self._last: tuple[int, Merged] | None = None

    def __getitem__(self, k: int) -> Merged:
        if self._last is None or self._last[0] != k:
            merged = self.develop(k)
            if merged.value.shape != self.shape:
                raise InputError.of(
                    f"pictures of light {k}",
                    f"{merged.value.shape[1]}x{merged.value.shape[0]}, {merged.value.shape[2]} channels",
                    f"must be {self.shape[1]}x{self.shape[0]} with {self.shape[2]} channels like the first",
                    "Give all pictures uncropped, from one camera, with one kind of file.",
                )
            self._last = (k, merged)
            empty = np.empty((0, 0, 0), dtype=np.float32)
            self.told[k] = replace(merged, value=empty, variance=empty)  # what was said about it, without its pixels
        return self._last[1]


class _Lazy(BackendArray):
    """Values or variances of all lights as one array that is read when it is indexed."""

    def __init__(self, frames: DevelopedFrames, name: str) -> None:
        self.frames, self.name = frames, name
        self.shape = (frames.count, *frames.shape)
        self.dtype = np.dtype(np.float32)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._get)

    def _get(self, key: tuple[Any, ...]) -> NDArray[np.float32]:
        first, rest = key[0], key[1:]
        if isinstance(first, slice):
            chosen = [getattr(self.frames[k], self.name)[rest] for k in range(*first.indices(self.shape[0]))]
            return np.stack(chosen) if chosen else np.empty((0, *self.shape[1:]), dtype=np.float32)
        return np.asarray(getattr(self.frames[int(first)], self.name)[rest])


def lazy_images(frames: DevelopedFrames, name: str, channels: Sequence[str]) -> xr.DataArray:
    """(light, row, column, channel) values ("value") or variances ("variance") that are developed when read."""
    variable = xr.Variable(
        ("light", "row", "column", "channel"), indexing.LazilyIndexedArray(_Lazy(frames, name)), fastpath=True
    )
    return xr.DataArray(variable, coords={"channel": list(channels)})


@dataclass(frozen=True, eq=False)
class PhotographedRig:
    """Photographs of a sphere with everything that is known about how they were taken.

    Attributes
    ----------
    name
        What the data set is called.
    frames
        Pictures by light, developed when read.
    channels
        Their names.
    camera, lights, sphere
        The rig; world frame, mm.
    pose
        How the sphere was found; None where it was given.
    sphere_covariance
        (4, 4) of centre and radius, mm².
    light_covariances
        (3, 3) of each light's direction (unit length²) or position (mm²).
    white
        Value at exposure 1 that a radiance of 1 gives, by channel; 1 without a white reference.
    white_sd
        Its relative standard uncertainty; NaN without one: the BRDF is known up to a factor.
    focal_sd
        Relative standard uncertainty of the focal length.
    mask
        (rows, columns) True where usable; None for everywhere.
    noise_known
        "declared", "estimated", "quantisation" (only the steps of the stored values) or "unknown".
    linearity
        What an exposure stack said; None without one.
    highlights
        For each light what the mirror balls showed.
    calibration, colour
        Of the camera and its colours; None without.
    sized
        Whether the solid angle of every light was said.
    cut
        Whether a part of the sphere may lie outside the pictures.
    corrected
        Faults that a calibration took out: dark, flat, lens, linearity, stray, colour.
    files
        Files that were read, by what they are.
    notes, warnings
        What a reader should know; what is likely wrong.
    """

    name: str
    frames: DevelopedFrames
    channels: tuple[str, ...]
    camera: Camera
    lights: tuple[Light, ...]
    sphere: Sphere
    pose: SpherePose | None
    sphere_covariance: FloatArray
    light_covariances: tuple[FloatArray, ...]
    white: FloatArray
    white_sd: float = float("nan")
    focal_sd: float = 0.0
    mask: NDArray[np.bool_] | None = None
    noise_known: str = "unknown"
    linearity: Linearity | None = None
    highlights: tuple[tuple[Highlight, ...], ...] = ()
    calibration: CameraCalibration | None = None
    colour: ColourCalibration | None = None
    sized: bool = False
    cut: bool = False
    corrected: frozenset[str] = frozenset()
    files: dict[str, list[str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def images(self) -> xr.DataArray:
        """(light, row, column, channel) linear radiance at exposure 1, NaN where not usable; read when indexed."""
        return lazy_images(self.frames, "value", self.channels)

    @property
    def variance(self) -> xr.DataArray | None:
        """Variance of the images; None where the noise is not known."""
        return None if self.noise_known == "unknown" else lazy_images(self.frames, "variance", self.channels)

    def matte_linearity(self, *, lights: int = 12, pixels: int = 4000, highlight: float = HIGHLIGHT) -> Linearity:
        """Linearity as the sphere itself shows it off its highlight: whether values follow the cosine.

        Left out is what lies within `highlight` (rad) of the half vector, where gloss is.

        Raises
        ------
        InputError
            Fewer than a hundred usable values.
        """
        chosen = np.unique(np.linspace(0, len(self.lights) - 1, min(lights, len(self.lights))).astype(int))
        rows, columns = self.inside(pixels)
        _, seen = self.camera.rays(columns, rows)
        hits = self.sphere.meet(*self.camera.rays(columns, rows))
        values, variances, cosines, aside = [], [], [], []
        for k in chosen:
            light = self.lights[k]
            at = self.frames[int(k)].value[rows, columns]
            noise = self.frames[int(k)].variance[rows, columns]
            variances.append((noise / (self.white * light.intensity) ** 2).mean(axis=-1) / noise.shape[-1])
            towards, scale = light.at(hits.points_mm)
            half = towards - seen
            half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
            off = np.einsum("ni,ni->n", half, hits.normals) <= np.cos(highlight)
            values.append(np.where(off, (at / self.white / light.intensity).mean(axis=-1), np.nan))
            cosines.append(np.einsum("ni,ni->n", towards, hits.normals) * scale)
            aside.append(float(np.max(-np.einsum("ni,ni->n", towards, seen), initial=-1.0)))
        stacked = np.array(cosines)
        beside = min(aside) > np.cos(BESIDE)
        return from_matte_sphere(
            np.array(values), stacked / stacked.max(), beside=beside, variances=np.array(variances)
        )

    def inside(
        self, most: int, max_angle: float = float(np.deg2rad(75.0))
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of about `most` usable pixels whose normals lie within an angle of the eye's direction."""
        curve = self.sphere.outline(self.camera)
        low = np.clip(np.floor(curve.min(axis=0)).astype(int), 0, None)
        high = np.minimum(np.ceil(curve.max(axis=0)).astype(int) + 1, [self.camera.width, self.camera.height])
        step = max(int(np.sqrt((high - low).prod() / most)), 1)
        columns, rows = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
        origins, towards = self.camera.rays(columns, rows)
        hits = self.sphere.meet(origins, towards)
        keep = hits.hit & (-np.einsum("...i,...i->...", hits.normals, towards) >= np.cos(max_angle))
        if self.mask is not None:
            keep &= self.mask[rows, columns]
        return rows[keep], columns[keep]


def with_matte_intensities(rig: PhotographedRig, *, pixels: int = 20_000) -> PhotographedRig:
    """The same rig with the lights' relative intensities at which the sphere best follows a cosine.

    What the BRDF itself makes of the lights' places is thereby taken out in the mean: only for a matte sphere.

    Raises
    ------
    InputError
        A light that lights no pixel that is in view.
    """
    rows, columns = rig.inside(pixels)
    hits = rig.sphere.meet(*rig.camera.rays(columns, rows))
    values, cosines = [], []
    for k, light in enumerate(rig.lights):
        values.append(rig.frames[k].value[rows, columns])
        towards, scale = light.at(hits.points_mm)
        cosines.append(np.einsum("ni,ni->n", towards, hits.normals) * scale / light.at(rig.sphere.centre_mm)[1])
    found, error = lambert_intensities(np.array(values, dtype=np.float64), np.array(cosines))
    if not np.all(np.isfinite(found) & (found > 0)):
        dark = int(np.flatnonzero(~np.all(np.isfinite(found) & (found > 0), axis=1))[0])
        raise InputError.of(f"lights[{dark}]", "no light on the sphere", "must light it", "Give its intensity.")
    centre = [light.at(rig.sphere.centre_mm)[1] for light in rig.lights]
    lights = tuple(
        replace(light, intensity=one / float(scale))
        for light, one, scale in zip(rig.lights, found, centre, strict=True)
    )
    told = f"Light intensities were taken from the sphere, as if it were matte: +- {float((error / found).max()):.1%}."
    return replace(rig, lights=lights, notes=(*rig.notes, told))
