"""Samples of a BRDF from images of a sphere: one for each pixel and light (Marschner et al. 2000, section 3)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypedDict, Unpack

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.angles import local_frames
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.images import Frames, Patch, VarianceModel
from livlab.brdf.rig import rig_variables
from livlab.brdf.samples import angles_of, assemble
from livlab.brdf.view import see
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]

MAX_ANGLE = float(np.deg2rad(80.0))
MAX_BYTES = 2 << 30
BYTES_PER_PIXEL = 600
"""Peak of temporary memory for each pixel of the box around the sphere."""

_SHADOW = -0.05
"""cos θ_i below which a point lies in the attached shadow, clear of a source of some width."""


class Options(TypedDict, total=False):
    """Keywords of `extract`, described there."""

    exposure: npt.ArrayLike
    white: npt.ArrayLike
    variance: xr.DataArray | VarianceModel | None
    mask: npt.ArrayLike | xr.DataArray | None
    saturation: float | None
    max_saturated: float
    max_angle: float
    grazing_px: float
    cut: bool
    empty_lights: Literal["refuse", "skip"]
    axis: npt.ArrayLike
    max_bytes: int


@dataclass(frozen=True)
class Noise:
    """Variance of a pixel's value: `read`**2 + `gain` * value, in the unit of the images.

    Parameters
    ----------
    read
        Standard deviation in the dark.
    gain
        Variance per value of the photon noise: 1 / (electrons that make a value of 1).
    """

    read: float = 0.0
    gain: float = 0.0

    def __post_init__(self) -> None:
        if not (0 <= self.read < np.inf and 0 <= self.gain < np.inf and self.read + self.gain > 0):
            raise InputError.of("noise", self, "read and gain must be >= 0, one of them > 0", "Leave variance out.")

    def __call__(self, value: FloatArray) -> FloatArray:
        """Variance of values."""
        return self.read**2 + self.gain * np.maximum(value, 0.0)


def extract(
    images: xr.DataArray, camera: Camera, lights: Sequence[Light], sphere: Sphere, **options: Unpack[Options]
) -> xr.Dataset:
    """One sample of the BRDF for each light and for each pixel whose centre sees the sphere.

    f = L / (E cos θ_i), with the radiance L = value / (exposure · white) and E the light's irradiance on a surface that
    faces it, at the point that the pixel's centre sees (Marschner et al. 2000, section 3). A pixel averages over its
    footprint; `livlab.brdf.footprint` gives the directions over which a fit has to average its model likewise.

    Parameters
    ----------
    images : DataArray (light, row, column[, channel])
        Linear values, NaN where not usable. Read light by light: it may lie on disk.
    camera, lights, sphere
        The rig. One light for each image; intensities for each channel, or one for all.

    Other Parameters
    ----------------
    exposure : scalar or (light,)
        What the values are to be divided by, image by image; 1.
    white : scalar, (channel,) or (light, channel)
        Value at exposure 1 that a radiance of 1 would give (1); of a white target of reflectance ρ under irradiance E
        that reads V it is V π / (ρ E).
    variance : DataArray like images, Noise, or None
        Variance of the values, in their unit squared. None leaves the standard errors NaN.
    mask : (row, column) or (light, row, column) bools, or None
        True where usable.
    saturation : float or None
        Values at or above it, in any channel, are left out and counted. None: the largest value of unsigned integers,
        no limit for others.
    max_saturated : float
        Share of a light's pixels that may be saturated; 0.02.
    max_angle : float
        Largest θ_i and θ_o in radians; 80 degrees.
    grazing_px : float
        Smallest (1 − sin θ_o) R_px, the distance from the outline in pixels; 0.8.
    cut : bool
        Accept a sphere that the frame cuts.
    empty_lights : "refuse" or "skip"
        What to do with a light that gives no sample, for instance from behind.
    axis : (3,) array
        Pole of the local frames (world y), see `livlab.brdf.angles.local_frames`.
    max_bytes : int
        Memory that the result and its making may take, images not counted; 2 GiB.

    Returns
    -------
    Dataset
        Dimension `sample`: wi, wo (sample, xyz) in the local frame; value, standard_error (sample, channel) in 1/sr;
        theta_i, theta_o, theta_h, theta_d, phi_d; pixel_solid_angle, source_solid_angle, area; row, column, light.
        For each light (dimension `light_index`) the pixels that were used and dropped, and the mean radiance in the
        attached shadow over that of the samples, which stray light raises above 0; and the rig.

    Raises
    ------
    InputError
        Counts or shapes that differ, a camera or light inside the sphere, a sphere cut by the frame or behind the
        camera, an overexposed image, a light that gives no sample, more memory than `max_bytes`.
    """
    return Extraction(images, camera, lights, sphere, **options).samples()


def by_light(
    images: xr.DataArray, camera: Camera, lights: Sequence[Light], sphere: Sphere, **options: Unpack[Options]
) -> Iterator[xr.Dataset]:
    """Samples as `extract` gives them, one light at a time, so that memory does not grow with the lights."""
    return Extraction(images, camera, lights, sphere, **options).by_light()


class Extraction:
    """An extraction that is checked and ready: what the pixels see is known, the images are still unread."""

    def __init__(
        self,
        images: xr.DataArray,
        camera: Camera,
        lights: Sequence[Light],
        sphere: Sphere,
        *,
        exposure: npt.ArrayLike = 1.0,
        white: npt.ArrayLike = 1.0,
        variance: xr.DataArray | VarianceModel | None = None,
        mask: npt.ArrayLike | xr.DataArray | None = None,
        saturation: float | None = None,
        max_saturated: float = 0.02,
        max_angle: float = MAX_ANGLE,
        grazing_px: float = 0.8,
        cut: bool = False,
        empty_lights: Literal["refuse", "skip"] = "refuse",
        axis: npt.ArrayLike = (0.0, 1.0, 0.0),
        max_bytes: int = MAX_BYTES,
    ) -> None:
        if not 0 < max_angle < np.pi / 2:
            raise InputError.of("max_angle", max_angle, "must lie between 0 and pi/2", "Give radians; 1.396 is 80 deg.")
        if not grazing_px >= 0:
            raise InputError.of("grazing_px", grazing_px, "must be >= 0", "Give 0.8 pixels.")
        self.frames = Frames(images, lights, exposure, white, variance, mask, saturation, (camera.height, camera.width))
        self.camera, self.lights, self.sphere = camera, list(lights), sphere
        for k, light in enumerate(self.lights):
            _check_light(k, light, sphere)
        self.max_saturated, self.max_angle, self.max_bytes = max_saturated, max_angle, max_bytes
        self.skip_empty = empty_lights == "skip"
        self.view = see(
            camera,
            sphere,
            max_angle=max_angle,
            grazing_px=grazing_px,
            cut=cut,
            max_pixels=max(max_bytes // BYTES_PER_PIXEL, 1),
        )
        self.locals = local_frames(self.view.normals, axis)
        self.wo = np.einsum("nij,nj->ni", self.locals, self.view.to_eye)
        self.axis = np.asarray(axis, dtype=np.float64)

    def samples(self) -> xr.Dataset:
        """All lights in one data set."""
        capacity = sum(len(self._lit(light)[0]) for light in self.lights)
        channels = self.frames.channel_count
        words = 3 + 3 + channels * (1 + self.frames.noisy) + 5 + 3 + 2
        needed = 8 * words * capacity + BYTES_PER_PIXEL * len(self.view.rows)
        if needed > self.max_bytes:
            raise InputError.of(
                "images",
                f"{capacity} samples, {needed / 2**20:.0f} MiB",
                f"take more memory than max_bytes = {self.max_bytes / 2**20:.0f} MiB",
                "Merge light by light (livlab.brdf.sphere.by_light into livlab.brdf.table.merge), bin the images, or "
                "raise max_bytes.",
            )
        store: dict[str, npt.NDArray[np.generic]] = {}
        counts, filled = [], 0
        for k in range(len(self.lights)):
            columns, count = self._one(k)
            size = len(columns["light"])
            for name, values in columns.items():
                if name not in store:
                    store[name] = np.empty((capacity, *values.shape[1:]), dtype=values.dtype)
                store[name][filled : filled + size] = values
            filled += size
            counts.append(count)
        return self._dataset({name: values[:filled] for name, values in store.items()}, counts, self.lights)

    def by_light(self) -> Iterator[xr.Dataset]:
        """One data set for each light that gives samples; `light` keeps its index, the rig holds that light alone."""
        for k, light in enumerate(self.lights):
            columns, count = self._one(k)
            if len(columns["light"]):
                yield self._dataset(columns, [count], [light])

    def _lit(self, light: Light) -> tuple[npt.NDArray[np.intp], FloatArray, FloatArray, FloatArray]:
        """Pixels of the view that a light reaches within the largest angle; direction, scale, cosine for all."""
        towards, scale = light.at(self.view.points_mm)
        cos_i = np.einsum("ni,ni->n", towards, self.view.normals)
        return np.flatnonzero(cos_i >= np.cos(self.max_angle)), towards, scale, cos_i

    def _one(self, k: int) -> tuple[dict[str, npt.NDArray[np.generic]], dict[str, object]]:
        view, light = self.view, self.lights[k]
        lit, towards, scale, cos_i = self._lit(light)
        patch = self.frames.patch(k, view.rows, view.columns)
        usable = patch.finite & ~patch.masked & ~patch.saturated
        count: dict[str, object] = {
            "used": int(np.count_nonzero(usable[lit])),
            "dropped_not_finite": int(np.count_nonzero(~patch.finite[lit] & ~patch.masked[lit])),
            "dropped_masked": int(np.count_nonzero(patch.masked[lit])),
            "dropped_saturated": int(np.count_nonzero((patch.saturated & ~patch.masked)[lit])),
        }
        self._check_one(k, len(lit), float(cos_i.max()), count)
        count["shadow_level"] = _shadow_level(patch, usable, cos_i, lit)
        at = lit[usable[lit]]
        wi = np.einsum("nij,nj->ni", self.locals[at], towards[at])
        irradiance = scale[at, None] * light.intensity * cos_i[at, None]
        columns: dict[str, npt.NDArray[np.generic]] = {
            "wi": wi,
            "wo": self.wo[at],
            "value": patch.radiance[at] / irradiance,
        }
        if patch.variance is not None:
            columns["standard_error"] = np.sqrt(patch.variance[at]) / irradiance
        columns |= angles_of(wi, self.wo[at])
        columns["pixel_solid_angle"] = view.solid_angle_sr[at]
        centre_scale = light.at(self.sphere.centre_mm)[1]
        columns["source_solid_angle"] = light.solid_angle_sr * scale[at] / centre_scale
        columns["area"] = view.area_mm2[at]
        columns["row"], columns["column"] = view.rows[at], view.columns[at]
        columns["light"] = np.full(len(at), k, dtype=np.int32)
        return columns, count

    def _check_one(self, k: int, lit: int, cos_max: float, count: dict[str, object]) -> None:
        saturated = int(count["dropped_saturated"])  # type: ignore[call-overload]
        if saturated > self.max_saturated * max(lit, 1):
            raise InputError.of(
                f"images[{k}]",
                f"{saturated} of {lit} pixels saturated",
                f"is overexposed: at most {self.max_saturated:.3g} of a light's pixels may be",
                "Take a shorter exposure or merge several into one HDR image, or raise max_saturated.",
            )
        if count["used"] or self.skip_empty:
            return
        if cos_max <= 0:
            why = "stands behind: it lights no point that the camera sees"
        elif lit == 0:
            why = f"lights what the camera sees only beyond {np.rad2deg(self.max_angle):.3g} degrees from the normal"
        else:
            lost = f"{count['dropped_not_finite']} not finite, {count['dropped_masked']} masked"
            why = f"leaves none of {lit} pixels: {lost}"
        raise InputError.of(
            f"lights[{k}]",
            "no sample",
            why,
            "Check that its direction points from the sphere to the light and that it belongs to this image; leave it "
            "out, or pass empty_lights='skip'.",
        )

    def _dataset(
        self,
        columns: dict[str, npt.NDArray[np.generic]],
        counts: Sequence[dict[str, object]],
        lights: Sequence[Light],
    ) -> xr.Dataset:
        arrays = dict(columns)
        wi, wo, value = (np.asarray(arrays.pop(name), dtype=np.float64) for name in ("wi", "wo", "value"))
        error = np.asarray(arrays.pop("standard_error", np.broadcast_to(np.nan, value.shape)), dtype=np.float64)
        attrs = {
            "source": "images of a sphere",
            "pole": self.axis.tolist(),
            "max_angle_rad": self.max_angle,
            "radius_px": self.view.radius_px,
        }
        samples = assemble(wi, wo, value, error, self.frames.channels, arrays, attrs)
        each = [replace(light, intensity=np.broadcast_to(light.intensity, value.shape[1])) for light in lights]
        dims = ("light_index", "channel")
        tallies = {
            name: xr.DataArray([count[name] for count in counts], dims=dims[: 1 + (name == "shadow_level")])
            for name in counts[0]
        }
        tallies["shadow_level"].attrs["long_name"] = "mean radiance in the attached shadow over that of the samples"
        return samples.assign(rig_variables(self.camera, each, self.sphere)).assign(tallies)


def _shadow_level(
    patch: Patch, usable: npt.NDArray[np.bool_], cos_i: FloatArray, lit: npt.NDArray[np.intp]
) -> FloatArray:
    dark = usable & (cos_i < _SHADOW)
    bright = lit[usable[lit]]
    if not dark.any() or not len(bright):
        return np.full(patch.radiance.shape[1], np.nan)
    level = patch.radiance[bright].mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(level > 0, patch.radiance[dark].mean(axis=0) / level, np.nan))


def _check_light(k: int, light: Light, sphere: Sphere) -> None:
    if light.position_mm is None:
        return
    distance = float(np.linalg.norm(light.position_mm - sphere.centre_mm))
    if distance <= sphere.radius_mm * (1 + 1e-9):
        raise InputError.of(
            f"lights[{k}].position_mm",
            light.position_mm.tolist(),
            f"must lie outside the sphere of radius {sphere.radius_mm:.6g} mm ({distance:.6g} mm from its centre)",
            "Check the unit, mm; a unit vector is a direction, not a position.",
        )
