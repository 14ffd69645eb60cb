"""Images of a sphere, one light after the other: checked, scaled to radiance, only the part that is asked for."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.geometry import Camera, Light
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


class VarianceModel(Protocol):
    """Variance of pixel values from the values themselves."""

    def __call__(self, value: FloatArray) -> FloatArray:
        """Variance in the unit of the values squared."""
        ...


class Patch(NamedTuple):
    """Pixels of one image: radiance and its variance (n, channel), and which (n,) are usable, masked, saturated."""

    radiance: FloatArray
    variance: FloatArray | None
    finite: BoolArray
    masked: BoolArray
    saturated: BoolArray


class Frames:
    """Images with everything that turns their values into radiance; see `livlab.brdf.sphere.extract`.

    Raises
    ------
    InputError
        Counts and shapes that differ between images, lights, camera, exposure, white reference, variance and mask; an
        exposure or white reference that is not > 0.
    """

    def __init__(
        self,
        images: xr.DataArray,
        lights: Sequence[Light],
        exposure: npt.ArrayLike,
        white: npt.ArrayLike,
        variance: xr.DataArray | VarianceModel | None,
        mask: npt.ArrayLike | xr.DataArray | None,
        saturation: float | None,
        size: tuple[int, int],
    ) -> None:
        self.images = _ordered("images", images)
        self.channels = self.images["channel"].values.tolist() if "channel" in self.images.coords else None
        count, rows, columns, self.channel_count = self.images.shape
        if count != len(lights) or count == 0:
            raise InputError.of(
                "images",
                f"{count} images, {len(lights)} lights",
                "must be one image for each light, at least one",
                "Check that no image and no line of the lights is missing, and that their order is the same.",
            )
        if (rows, columns) != size:
            raise InputError.of(
                "images",
                f"{columns} x {rows}",
                f"must be as large as the camera's {size[1]} x {size[0]} pixels",
                "Give the camera of these images; a crop or a binning changes its matrix.",
            )
        for k, light in enumerate(lights):
            if light.intensity.size not in (1, self.channel_count):
                raise InputError.of(
                    f"lights[{k}].intensity",
                    light.intensity.tolist(),
                    f"must be 1 number, or {self.channel_count}, one for each channel",
                    "Give one for each channel of the images.",
                )
        self.scale = _positive("exposure", exposure, (count,))[:, None] * _positive_white(
            white, count, self.channel_count
        )
        self.noise_model: VarianceModel | None = None if isinstance(variance, xr.DataArray) else variance
        self.variance = _ordered("variance", variance) if isinstance(variance, xr.DataArray) else None
        if self.variance is not None and self.variance.shape != self.images.shape:
            raise InputError.of(
                "variance", self.variance.shape, f"must have the images' shape {self.images.shape}", "Give one a value."
            )
        self.mask = _mask(mask, count, (rows, columns))
        self.saturation = np.inf if saturation is None else float(saturation)
        if saturation is None and self.images.dtype.kind == "u":
            self.saturation = float(np.iinfo(self.images.dtype).max)

    @property
    def noisy(self) -> bool:
        """Whether the variance of the values is known."""
        return self.variance is not None or self.noise_model is not None

    def patch(self, k: int, rows: npt.NDArray[np.int32], columns: npt.NDArray[np.int32]) -> Patch:
        """Radiance at some pixels of image k; only the box around them is read."""
        tall = slice(int(rows.min()), int(rows.max()) + 1)
        wide = slice(int(columns.min()), int(columns.max()) + 1)
        inside = (rows - tall.start, columns - wide.start)
        value = self.images.isel(light=k, row=tall, column=wide).values[inside].astype(np.float64)
        finite = np.asarray(np.isfinite(value).all(axis=-1))
        saturated = np.asarray((value >= self.saturation).any(axis=-1)) & finite
        noise: FloatArray | None = None
        if self.variance is not None:
            noise = self.variance.isel(light=k, row=tall, column=wide).values[inside].astype(np.float64)
            bad = ~(noise >= 0).all(axis=-1) & finite
            if bad.any():
                raise InputError.of(
                    f"variance of image {k}",
                    float(noise[bad].min()),
                    "must be >= 0 wherever the image is usable",
                    "Set the image to NaN where its variance is not known.",
                )
        elif self.noise_model is not None:
            noise = self.noise_model(np.where(np.isfinite(value), value, 0.0))
        if noise is not None:
            noise = noise / self.scale[k] ** 2
        if self.mask is None:
            masked = np.zeros(len(rows), dtype=bool)
        else:
            masked = ~self.mask[k if len(self.mask) > 1 else 0][rows, columns]
        return Patch(value / self.scale[k], noise, finite, masked, saturated)


def binned(images: xr.DataArray, camera: Camera, factor: int) -> tuple[xr.DataArray, Camera]:
    """Images of means over squares of `factor` by `factor` pixels, and the camera that would have taken them.

    A square with a pixel that is not usable (NaN) is not usable. Saturated pixels are to be made NaN before, since a
    mean hides them.

    Raises
    ------
    InputError
        Width or height is not a multiple of the factor.
    """
    sizes = (images.sizes["row"], images.sizes["column"])
    if factor < 1 or any(size % factor for size in sizes):
        raise InputError.of("factor", factor, f"must divide {sizes[1]} x {sizes[0]}", "Crop the images first.")
    matrix = camera.matrix / factor
    # Centres have whole numbers, so the corner of the frame lies at -0.5 whatever the pixels' size.
    matrix[:2, 2] = (camera.matrix[:2, 2] + 0.5) / factor - 0.5
    matrix[2, 2] = 1.0
    squares = images.coarsen(row=factor, column=factor).construct(row=("row", "y"), column=("column", "x"))
    small = squares.mean(("y", "x"), skipna=False)
    return small, replace(camera, width=sizes[1] // factor, height=sizes[0] // factor, matrix=matrix)


def _ordered(name: str, images: xr.DataArray) -> xr.DataArray:
    if not isinstance(images, xr.DataArray):
        raise InputError.of(name, type(images).__name__, "must be an xarray DataArray", "Name its dimensions.")
    if images.dtype.kind not in "fiu":
        raise InputError.of(name, str(images.dtype), "must hold real numbers", "Convert the images to linear values.")
    dims = set(images.dims)
    if dims - {"channel"} != {"light", "row", "column"}:
        raise InputError.of(
            name, images.dims, "must have the dimensions light, row, column and channel", "Name them so."
        )
    if "channel" not in dims:
        images = images.expand_dims("channel", axis=-1)
    return images.transpose("light", "row", "column", "channel")


def _positive(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim and array.shape != shape:
        raise InputError.of(name, array.shape, f"must be one number or have the shape {shape}", "Give one a light.")
    if not np.all(np.isfinite(array) & (array > 0)):
        raise InputError.of(name, value, "must be finite and > 0", "Leave out images that were not exposed.")
    return np.broadcast_to(array, shape)


def _positive_white(value: npt.ArrayLike, count: int, channels: int) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    shape = (count, channels) if array.ndim == 2 else (channels,)
    return np.broadcast_to(_positive("white", array, shape), (count, channels))


def _mask(mask: npt.ArrayLike | xr.DataArray | None, count: int, size: tuple[int, int]) -> BoolArray | None:
    if mask is None:
        return None
    if isinstance(mask, xr.DataArray):
        mask = mask.transpose(..., "row", "column").values
    array = np.asarray(mask)
    if array.dtype != np.bool_ or array.shape not in (size, (count, *size)):
        raise InputError.of(
            "mask",
            f"{array.dtype} {array.shape}",
            f"must hold bools in the shape {size} or {(count, *size)}",
            "Compare it with a threshold, as in mask > 0; True is usable.",
        )
    return array if array.ndim == 3 else array[None]
