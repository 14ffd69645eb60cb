"""Image files: linear sRGB as OpenEXR, with spectral channels beside it if wanted, and sRGB as PNG."""

from __future__ import annotations

import importlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr

from livlab.core.files import whole, write_whole
from livlab.errors import InputError
from livlab.model.colour.encoding import Handling, check_channels, encode_srgb, in_gamut
from livlab.model.colour.primaries import SRGB_CHROMATICITIES

Image = tuple[str, str]
_PLANE: Image = ("row", "column")


def write_exr(
    path: Path | str,
    rgb: xr.DataArray,
    *,
    spectral: xr.DataArray | None = None,
    metadata: Mapping[str, str | int | float] | None = None,
    depth: Literal["float", "half"] = "float",
) -> Path:
    """Write linear sRGB as OpenEXR, whole or not at all; values are neither clipped nor exposed.

    Parameters
    ----------
    path
        Ends in .exr; an old file of that name is replaced.
    rgb
        (row, column, channel) linear sRGB.
    spectral
        (row, column, wavelength) further channels named `S0.560,000000nm`: the spectral layout of Fichet et al.
        2021 for emission, S0 the first Stokes component, with the comma as decimal sign.
    metadata
        Further attributes of the header, e.g. illuminant and observer.
    depth
        32 or 16 bits a channel; spectral channels always have 32.

    Returns
    -------
    The path.

    Raises
    ------
    InputError
        Wrong dimensions, an empty image, another suffix, or a name that the header already has.
    EnvironmentProblem
        The file cannot be written; the old one, if any, is untouched.
    """
    openexr = importlib.import_module("OpenEXR")
    path = _checked_path(path, ".exr")
    image = _plane(rgb)
    if depth not in ("float", "half"):
        raise InputError.of("depth", depth, 'must be "float" or "half"', "Pick one.")
    pixels = image.to_numpy().astype(np.float16 if depth == "half" else np.float32)
    channels: dict[str, Any] = {"RGB": np.ascontiguousarray(pixels)}
    header: dict[str, Any] = {
        "compression": openexr.ZIP_COMPRESSION,
        "type": openexr.scanlineimage,
        "chromaticities": SRGB_CHROMATICITIES,
        "comments": "linear sRGB, a perfect white diffuser is 1",
    }
    if spectral is not None:
        if spectral.sizes.get("row") != image.sizes["row"] or spectral.sizes.get("column") != image.sizes["column"]:
            raise InputError.of("spectral", dict(spectral.sizes), "must have the image's rows and columns", "Mend it.")
        header |= {"spectralLayoutVersion": "1.0", "emissiveUnits": "1"}
        for wavelength in spectral["wavelength"].to_numpy():
            values = spectral.sel(wavelength=wavelength).transpose(*_PLANE).to_numpy().astype(np.float32)
            channels["S0." + f"{wavelength:.6f}nm".replace(".", ",")] = np.ascontiguousarray(values)
    for name, value in (metadata or {}).items():
        if name in header:
            raise InputError.of("metadata", name, "is a name that the header already has", "Take another name.")
        header[name] = value if isinstance(value, str) else float(value)
    with whole(path) as temporary:
        try:
            openexr.File(header, channels).write(str(temporary))
        except RuntimeError as error:
            raise OSError(str(error)) from error
    return path


def write_png(
    path: Path | str,
    rgb: xr.DataArray,
    *,
    exposure: float = 1.0,
    gamut: Handling = "desaturate",
    bits: Literal[8, 16] = 8,
    alpha: xr.DataArray | None = None,
) -> xr.DataArray:
    """Write linear sRGB as a PNG for screens, whole or not at all.

    Parameters
    ----------
    path
        Ends in .png; an old file of that name is replaced.
    rgb
        (row, column, channel) linear sRGB; a nan becomes black.
    exposure
        Factor on the linear values, 1 if white is to be white.
    gamut
        What to do with colours outside sRGB, as in `in_gamut`.
    bits
        8 or 16 a channel.
    alpha
        (row, column) opacity in [0, 1], not premultiplied; 8 bits only.

    Returns
    -------
    The linear image as shown, after exposure and gamut; its attributes count the colours moved, as `in_gamut`'s.

    Raises
    ------
    InputError
        Wrong dimensions, an empty image, another suffix, a bad exposure or number of bits.
    EnvironmentProblem
        The file cannot be written; the old one, if any, is untouched.
    """
    path = _checked_path(path, ".png")
    if not (np.isfinite(exposure) and exposure > 0):
        raise InputError.of("exposure", exposure, "must be finite and > 0", "Give a factor, 1 for none.")
    if bits not in (8, 16) or (bits == 16 and alpha is not None):
        raise InputError.of("bits", bits, "must be 8, or 16 without alpha", "Pick one.")
    shown = in_gamut(_plane(rgb) * exposure, gamut).assign_attrs(exposure=exposure)
    top = 2**bits - 1
    coded = np.rint(np.nan_to_num(np.asarray(encode_srgb(shown).to_numpy())) * top).astype(np.uint16)
    if alpha is not None:
        opacity = np.rint(np.clip(alpha.transpose(*_PLANE).to_numpy(), 0.0, 1.0) * top).astype(np.uint16)
        coded = np.concatenate([coded, opacity[..., None]], axis=2)
    write_whole(path, _png(coded, bits))
    return shown


def _png(coded: np.ndarray[Any, np.dtype[np.uint16]], bits: int) -> bytes:
    if bits == 8:
        from PIL import Image as Pillow
        from PIL.PngImagePlugin import PngInfo

        info = PngInfo()
        info.add(b"sRGB", b"\0")
        out = io.BytesIO()
        Pillow.fromarray(coded.astype(np.uint8)).save(out, format="png", pnginfo=info, optimize=True)
        return out.getvalue()
    import cv2  # Pillow writes no colour of 16 bits

    done, raw = cv2.imencode(".png", coded[..., ::-1])
    if not done:
        raise InputError.of("rgb", coded.shape, "could not be encoded as a PNG", "Write 8 bits.")
    return bytes(raw)


def _checked_path(path: Path | str, suffix: str) -> Path:
    path = Path(path)
    if path.suffix.lower() != suffix:
        raise InputError.of("path", str(path), f"must end in {suffix}", "Name the file so.")
    return path


def _plane(rgb: xr.DataArray) -> xr.DataArray:
    check_channels(rgb)
    if set(rgb.dims) != {*_PLANE, "channel"} or not rgb.size:
        raise InputError.of("rgb", dict(rgb.sizes), "needs the dimensions row, column and channel", "Give an image.")
    return rgb.transpose(*_PLANE, "channel")
