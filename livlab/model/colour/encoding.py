"""Linear sRGB and what a screen takes: the transfer function, and colours that a screen cannot show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, overload

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.colour.primaries import LUMINANCE
from livlab.units import FloatArray

Handling = Literal["clip", "desaturate"]


@dataclass(frozen=True)
class Gamut:
    """How many colours of an image a screen cannot show, and by how much.

    Attributes
    ----------
    colours
        Number of colours (pixels) judged; those with a nan are left out.
    below
        Colours with a channel under 0: too saturated for sRGB.
    above
        Colours with a channel over 1: brighter than white.
    lowest, highest
        Smallest and largest channel value.
    """

    colours: int
    below: int
    above: int
    lowest: float
    highest: float


@overload
def encode_srgb(linear: FloatArray) -> FloatArray: ...


@overload
def encode_srgb(linear: xr.DataArray) -> xr.DataArray: ...


def encode_srgb(linear: FloatArray | xr.DataArray) -> FloatArray | xr.DataArray:
    """Non-linear sRGB of linear sRGB: 12.92 c up to 0.0031308, 1.055 c^(1/2.4) − 0.055 above (IEC 61966-2-1).

    Values are not clipped; under 0 the function goes on as −f(−c), as in scRGB.

    Examples
    --------
    >>> encode_srgb(np.array([0.0, 0.0031308, 0.5, 1.0])).round(4)
    array([0.    , 0.0404, 0.7354, 1.    ])
    """
    if isinstance(linear, xr.DataArray):
        return linear.copy(data=encode_srgb(linear.to_numpy())).assign_attrs(encoding="sRGB")
    size = np.abs(linear)
    curve = 1.055 * np.maximum(size, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.asarray(np.sign(linear) * np.where(size <= 0.0031308, 12.92 * size, curve))


@overload
def decode_srgb(encoded: FloatArray) -> FloatArray: ...


@overload
def decode_srgb(encoded: xr.DataArray) -> xr.DataArray: ...


def decode_srgb(encoded: FloatArray | xr.DataArray) -> FloatArray | xr.DataArray:
    """Linear sRGB of non-linear sRGB, the inverse of `encode_srgb` (IEC 61966-2-1)."""
    if isinstance(encoded, xr.DataArray):
        return encoded.copy(data=decode_srgb(encoded.to_numpy())).assign_attrs(encoding="linear")
    size = np.abs(encoded)
    curve = ((np.maximum(size, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.asarray(np.sign(encoded) * np.where(size <= 0.04045, size / 12.92, curve))


def out_of_gamut(rgb: xr.DataArray, tolerance: float = 1e-6) -> Gamut:
    """Count the colours of linear sRGB that lie outside [0, 1] by more than the tolerance.

    Parameters
    ----------
    rgb
        Dimension `channel` and any others.

    Raises
    ------
    InputError
        No dimension `channel` of length 3.
    """
    check_channels(rgb)
    known = rgb.notnull().all("channel")
    low, high = rgb.min("channel"), rgb.max("channel")
    some = bool(known.any())
    return Gamut(
        colours=int(known.sum()),
        below=int((known & (low < -tolerance)).sum()),
        above=int((known & (high > 1.0 + tolerance)).sum()),
        lowest=float(low.where(known).min()) if some else float("nan"),
        highest=float(high.where(known).max()) if some else float("nan"),
    )


def in_gamut(rgb: xr.DataArray, how: Handling = "clip", *, ceiling: float = 1.0) -> xr.DataArray:
    """Linear sRGB brought into [0, ceiling]; the attributes count what was moved.

    Parameters
    ----------
    rgb
        Dimension `channel` and any others.
    how
        "clip" moves each channel to the nearest bound, which shifts hue. "desaturate" mixes a colour with the grey of
        its luminance, just as much as brings the channels under 0 to 0; what is then above the ceiling is clipped,
        as an overexposed photograph is. A colour of negative luminance becomes black.
    ceiling
        The brightest value kept; infinity leaves highlights alone.

    Raises
    ------
    InputError
        No dimension `channel` of length 3, or an unknown way.
    """
    found = out_of_gamut(rgb)
    if how == "clip":
        moved = rgb.clip(0.0, ceiling)
    elif how == "desaturate":
        weights = xr.DataArray(np.array(LUMINANCE), dims="channel")
        grey = (rgb * weights).sum("channel", skipna=False).clip(0.0)
        low = rgb.min("channel", skipna=False)
        mix = (grey / (grey - low).where(low < 0, 1.0)).where(low < 0, 1.0)
        moved = (grey + mix * (rgb - grey)).clip(0.0, ceiling).transpose(*rgb.dims)
    else:
        raise InputError.of("how", how, 'must be "clip" or "desaturate"', "Pick one.")
    return moved.assign_attrs(
        rgb.attrs, gamut=how, gamut_colours=found.colours, gamut_below=found.below, gamut_above=found.above
    )


def check_channels(rgb: xr.DataArray) -> None:
    """Raise `InputError` unless there is a dimension `channel` of length 3."""
    if rgb.sizes.get("channel") != 3:
        raise InputError.of("rgb", dict(rgb.sizes), "needs a dimension channel of length 3", "Give linear sRGB.")
