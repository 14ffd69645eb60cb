"""One photograph from a file: its stored values, their full scale, and the exposure that the camera wrote down."""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.linearity import CameraResponse
from livlab.acquire.photographs.lossy import Scatter, measured_scatter
from livlab.config.errors import nearest
from livlab.core.files import first_line
from livlab.core.picture_files import (
    DENSEST_TIFF,
    check_claim,
    check_png,
    check_png_pixels,
    deep_png,
    opened_tiff,
    png_depth,
)
from livlab.errors import InputError

MAX_PIXELS = 100_000_000
"""Photographs above this are refused from their header, before they are decoded."""

RAW_SUFFIXES = (".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw", ".raw")

FORMATS = ("PNG", "JPEG", "TGA", "BMP", "PPM", "GIF", "WEBP")
"""What Pillow may open. Among all it knows are formats that start other programs (Ghostscript for EPS)."""

_ORIENTATION = 0x0112

_REMEDY = "Give PNG, TIFF (8 or 16 bit), EXR, TGA, JPEG or a camera's raw file."


@dataclass(frozen=True)
class Exposure:
    """Exposure as the camera wrote it down; None where it did not.

    Attributes
    ----------
    seconds, iso, f_number
        Time, sensitivity, aperture.
    """

    seconds: float | None = None
    iso: float | None = None
    f_number: float | None = None

    @property
    def value(self) -> float | None:
        """Relative exposure seconds · (ISO / 100) / N²; what is not known counts as 1; None without a time.

        >>> Exposure(0.5, 200, 2.0).value
        0.25
        """
        if not self.seconds:
            return None
        return self.seconds * (self.iso or 100.0) / 100.0 / (self.f_number or 1.0) ** 2


@dataclass(frozen=True)
class Photograph:
    """What a file holds.

    Attributes
    ----------
    name
        File name.
    values
        (rows, columns, channels) as stored: unsigned integers or floating point; channels 1 (grey) or 3 (RGB).
    full_scale
        Largest value that the stored type, or the camera's white level, holds; inf of floating point.
    exposure
        From EXIF.
    linear
        True where the format says that the values are linear (raw, EXR), False where it says that they are encoded
        (a gamma or sRGB chunk, JPEG), None where it says nothing.
    notes
        What a reader should know.
    turned
        Whether EXIF asks viewers to turn or flip it; the values are as stored.
    response
        How its values stand for linear ones, where that was said of this picture by itself.
    scatter
        How far lossy compression leaves the stored values in doubt; None where there was none.
    """

    name: str
    values: NDArray[Any]
    full_scale: float
    exposure: Exposure
    linear: bool | None
    notes: tuple[str, ...] = ()
    turned: bool = False
    response: CameraResponse | None = None
    scatter: Scatter | None = None


def read_photograph(path: Path) -> Photograph:
    """Read a photograph; nothing is scaled, decoded to linear or balanced.

    A raw file is demosaiced bilinearly, black subtracted, with its sensor's own colours and no white balance.

    Raises
    ------
    InputError
        Missing, unreadable, truncated, no image, of several pages, or above `MAX_PIXELS`.
    """
    if not path.is_file():
        raise InputError.of("photograph", str(path), "is not a file", _like(path))
    try:
        with path.open("rb") as stream:
            magic = stream.read(8)
        check_png(path, "photograph")
        return _reader(path, magic)(path)
    except InputError:
        raise
    except PermissionError as error:
        raise InputError.of("photograph", str(path), "permission denied", "Mend its permissions.") from error
    except Exception as error:  # Pillow, tifffile, OpenEXR and LibRaw raise whatever they stumble over
        raise InputError.of(
            "photograph",
            path.name,
            f"cannot be decoded ({first_line(error)})",
            "It is truncated, damaged or no image; copy it again from the camera.",
        ) from error


def _like(path: Path) -> str:
    """What to do about a picture that is not there: the file that was meant, where one is named much like it."""
    number = re.findall(r"\d+", path.name)  # 11.png is not meant by 12.png
    try:
        there = [found.name for found in itertools.islice(path.parent.iterdir(), 10_000)]
    except OSError:
        return "Check the path."
    return nearest(path.name, [x for x in there if re.findall(r"\d+", x) == number]) or "Check the path."


def _reader(path: Path, magic: bytes) -> Callable[[Path], Photograph]:
    if path.suffix.lower() in RAW_SUFFIXES:
        return _raw
    if magic[:4] == b"\x76\x2f\x31\x01":
        return _exr
    if magic[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return _tiff
    return _pillow


def check_size(path: Path, width: int, height: int) -> None:
    """Raise if a picture is empty or larger than `MAX_PIXELS`."""
    if width * height > MAX_PIXELS or width * height == 0:
        raise InputError.of(
            "photograph",
            f"{path.name}: {width}x{height}",
            f"must have between 1 and {MAX_PIXELS // 1_000_000} million pixels",
            "Crop it to the sphere and its surroundings, or bin it.",
        )


def _channels(path: Path, values: NDArray[Any]) -> tuple[NDArray[Any], tuple[str, ...]]:
    """(rows, columns, 1 or 3); an alpha channel is dropped, and told where it is not full."""
    array = values[..., None] if values.ndim == 2 else values
    notes: tuple[str, ...] = ()
    if array.shape[2] in (2, 4):
        if not (array[..., -1] == array[..., -1].max()).all():
            notes = ("its transparency is ignored",)
        array = array[..., :-1]
    if array.ndim != 3 or array.shape[2] not in (1, 3):
        raise InputError.of("photograph", f"{path.name}: {values.shape}", "must be grey or RGB", _REMEDY)
    if array.dtype == np.bool_:
        array = array.astype(np.uint8) * np.uint8(255)
    if array.dtype.kind not in "uf":
        raise InputError.of("photograph", f"{path.name}: {array.dtype}", "must be unsigned or floating point", _REMEDY)
    return np.ascontiguousarray(array), notes


def _full_scale(values: NDArray[Any]) -> float:
    return float(np.iinfo(values.dtype).max) if values.dtype.kind == "u" else float("inf")


def _pillow(path: Path) -> Photograph:
    from PIL import Image, UnidentifiedImageError

    with warnings.catch_warnings():
        # The size is checked here, with an own message.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            image = Image.open(path, formats=FORMATS)
        except UnidentifiedImageError as error:
            raise InputError.of("photograph", path.name, "is no image that can be read", _REMEDY) from error
        except Image.DecompressionBombError as error:
            raise InputError.of(
                "photograph", path.name, f"must have at most {MAX_PIXELS // 1_000_000} million pixels", "Crop it."
            ) from error
    with image:
        check_size(path, *image.size)
        check_png_pixels(path, "photograph")
        if getattr(image, "n_frames", 1) > 1:
            raise InputError.of("photograph", path.name, "holds several pictures", "Give one picture a file.")
        kind, info = image.format, dict(image.info)
        tags = image.getexif()
        exposure, turned = _exif(tags.get_ifd(0x8769)), tags.get(_ORIENTATION, 1) not in (0, 1)
        image.load()
        deep = kind == "PNG" and png_depth(path) == 16 and image.mode not in ("I", "I;16", "I;16B", "F")
        if deep:
            array = deep_png(path)
        else:
            grey = image.mode in ("1", "L", "LA", "I", "F") or image.mode.startswith("I;")
            array = np.asarray(image if grey else image.convert("RGBA" if "A" in image.mode else "RGB"))
            if array.dtype == np.int32:
                array = array.astype(np.uint16)
    values, notes = _channels(path, array)
    lossy = kind in ("JPEG", "MPO", "WEBP")
    linear: bool | None = None
    if lossy:
        linear, notes = False, (*notes, "lossy compression spoils small differences")
    elif "srgb" in info or ("gamma" in info and abs(float(info["gamma"]) - 1) > 0.05):
        linear = False
    elif "gamma" in info:
        linear = True
    scatter = measured_scatter(values) if lossy else None
    return Photograph(path.name, values, _full_scale(values), exposure, linear, notes, turned, scatter=scatter)


def _exif(tags: Any) -> Exposure:
    def number(tag: int) -> float | None:
        value = tags.get(tag)
        value = value[0] if isinstance(value, tuple) and len(value) == 1 else value
        if isinstance(value, tuple) and len(value) == 2:
            value = value[0] / value[1] if value[1] else None
        try:
            plain = float(value)
        except (TypeError, ValueError, ZeroDivisionError):
            return None
        return plain if np.isfinite(plain) and plain > 0 else None

    return Exposure(number(33434), number(34855), number(33437))


def _tiff(path: Path) -> Photograph:
    import tifffile

    with opened_tiff(path, "photograph") as file:
        if not file.pages:
            raise ValueError("no page")
        if len(file.pages) != 1:
            raise InputError.of(
                "photograph", f"{path.name}: {len(file.pages)} pages", "must hold one picture", "Give one a file."
            )
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        check_size(path, page.imagewidth, page.imagelength)
        check_claim(path, "photograph", page.nbytes, DENSEST_TIFF)
        tags = {tag.code: tag.value for tag in page.tags}
        inner = tags.get(34665)
        named = {"ExposureTime": 33434, "ISOSpeedRatings": 34855, "PhotographicSensitivity": 34855, "FNumber": 33437}
        if isinstance(inner, dict):
            tags |= {named[k]: v for k, v in inner.items() if k in named}
        try:
            array = np.asarray(page.asarray())
        except ValueError as error:
            if "imagecodecs" not in str(error):
                raise
            raise InputError.of(
                "photograph", path.name, "has a compression that cannot be decoded here", "Save it uncompressed."
            ) from error
        if page.planarconfig == 2 and array.ndim == 3:
            array = np.moveaxis(array, 0, -1)
    values, notes = _channels(path, array)
    turned = tags.get(_ORIENTATION, 1) not in (0, 1)
    return Photograph(path.name, values, _full_scale(values), _exif(tags), None, notes, turned)


def _exr(path: Path) -> Photograph:
    import OpenEXR  # type: ignore[import-not-found]

    header = OpenEXR.File(str(path), header_only=True).header()
    low, high = header["dataWindow"]
    check_size(path, int(high[0] - low[0] + 1), int(high[1] - low[1] + 1))
    channels = OpenEXR.File(str(path)).channels()
    for names in (("RGB",), ("RGBA",), ("R", "G", "B"), ("Y",)):
        if all(name in channels for name in names):
            array = np.squeeze(np.stack([np.asarray(channels[name].pixels) for name in names], axis=-1))
            break
    else:
        raise InputError.of("photograph", f"{path.name}: {sorted(channels)}", "must hold R, G, B or Y", _REMEDY)
    values, notes = _channels(path, array.astype(np.float32))
    seconds = header.get("expTime")
    return Photograph(path.name, values, float("inf"), Exposure(float(seconds) if seconds else None), True, notes)


def _raw(path: Path) -> Photograph:
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            return _developed(path, raw)
    except rawpy.LibRawError as error:
        raise ValueError(error.args[0].decode() if isinstance(error.args[0], bytes) else str(error)) from error


def _developed(path: Path, raw: Any) -> Photograph:
    import rawpy

    check_size(path, raw.sizes.raw_width, raw.sizes.raw_height)
    values = raw.postprocess(
        gamma=(1, 1),
        no_auto_bright=True,
        # Scaling to the brightest pixel would give every exposure a scale of its own.
        adjust_maximum_thr=0.0,
        output_bps=16,
        user_wb=[1.0, 1.0, 1.0, 1.0],
        output_color=rawpy.ColorSpace.raw,
        demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
        user_flip=0,
    )
    other = raw.other
    exposure = Exposure(other.shutter_speed or None, other.iso_speed or None, other.aperture or None)
    return Photograph(
        path.name,
        values,
        65535.0,
        exposure,
        True,
        ("demosaiced: neighbouring pixels share noise",),
        raw.sizes.flip != 0,
    )


def eight_bit(picture: Photograph) -> NDArray[np.uint8]:
    """Stored values as 8 bits."""
    if picture.values.dtype == np.uint8:
        return picture.values
    share = picture.values / (picture.full_scale if np.isfinite(picture.full_scale) else 1.0)
    return np.asarray(np.round(255 * np.clip(share, 0, 1)), dtype=np.uint8)
