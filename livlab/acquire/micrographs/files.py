"""Pages of a micrograph file, one at a time: PNG, JPEG and the like by Pillow, TIFF stacks by tifffile."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

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

if TYPE_CHECKING:
    import tifffile

MAX_PIXELS = 100_000_000
"""Pages above this are refused before they are decoded: an RGB page of 16 bits would take 0.6 GB, its masks more."""

FORMATS = ("PNG", "JPEG", "TGA", "BMP", "PPM", "GIF", "WEBP")
"""What Pillow may open. Among all it knows are formats that start other programs (Ghostscript for EPS)."""

_NO_IMAGE = "Give a PNG, JPEG or TIFF with a red, a green and a blue channel, or a TIFF with several channels."


@dataclass(frozen=True)
class MicrographPage:
    """One image of a file.

    Attributes
    ----------
    source, number
        File name and the page's place in it, from 0.
    channels
        (H, W, C) values as stored.
    inside
        (H, W) True where a pixel counts; False where it is fully transparent. None where all count.
    is_rgb
        Whether the channels are red, green and blue, or just numbered.
    full_scale
        Largest value the stored type holds (1 for floating point).
    notes
        What a reader should know: lossy compression, partial transparency.
    """

    source: str
    number: int
    channels: NDArray[Any]
    inside: NDArray[np.bool_] | None
    is_rgb: bool
    full_scale: float
    notes: tuple[str, ...] = ()


def read_pages(path: Path) -> Iterator[MicrographPage]:
    """The pages of an image file, decoded one by one.

    Raises
    ------
    InputError
        If the file is missing, no image, truncated, without colour, of mixed page sizes, above `MAX_PIXELS`
        a page, or holds NaN, negative or (floating point) values above 1.
    """
    if not path.is_file():
        raise InputError.of("image", str(path), "is not a file", "Check the path.")
    try:
        with path.open("rb") as stream:
            magic = stream.read(4)
        check_png(path, "image")
        tiff = magic[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
        yield from _tiff_pages(path) if tiff else _pillow_pages(path, magic)
    except InputError:
        raise
    except PermissionError as error:
        raise InputError.of("image", str(path), "cannot be read: permission denied", "Mend its permissions.") from error
    except Exception as error:  # Pillow and tifffile raise whatever they stumble over
        raise InputError.of(
            "image", str(path), f"cannot be decoded ({first_line(error)})", "It is truncated, damaged or no image."
        ) from error


def _page(path: Path, number: int, array: NDArray[Any], *, is_rgb: bool, notes: tuple[str, ...] = ()) -> MicrographPage:
    name = f"{path.name}, page {number}"
    inside: NDArray[np.bool_] | None = None
    if is_rgb and array.shape[2] == 4:
        alpha, array = array[..., 3], array[..., :3]
        if not (alpha == alpha.max()).all() or alpha.max() == 0:
            inside = np.asarray(alpha > 0)
            notes = (*notes, "transparent pixels are left out of the region of interest")
    if array.dtype.kind == "f":
        if not np.isfinite(array).all():
            raise InputError.of(name, "NaN or infinite", "every pixel must be a finite number", "Mend the image.")
        full_scale = 1.0
        if array.max(initial=0.0) > 1.0 or array.min(initial=0.0) < 0.0:
            raise InputError.of(
                name,
                f"values {array.min():g} … {array.max():g}",
                "floating-point pixels must lie within [0, 1]",
                "Divide by the detector's full scale, or save as 8- or 16-bit integers.",
            )
    elif array.dtype.kind == "u":
        full_scale = float(np.iinfo(array.dtype).max)
    else:
        raise InputError.of(name, str(array.dtype), "must be unsigned integers or floating point", "Save it so.")
    return MicrographPage(path.name, number, array, inside, is_rgb, full_scale, notes)


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise InputError.of(
            "image",
            f"{path.name}: {width}×{height}",
            f"a page may have at most {MAX_PIXELS // 1_000_000} million pixels",
            "Crop it to the region of interest, or tile it.",
        )


def _gray(path: Path, what: str) -> InputError:
    return InputError.of("image", f"{path.name}: {what}", "has no colour to tell collagen from elastin", _NO_IMAGE)


def _pillow_pages(path: Path, magic: bytes) -> Iterator[MicrographPage]:
    from PIL import Image, ImageSequence, UnidentifiedImageError

    with warnings.catch_warnings():
        # The size is checked here, by the same reason and with an own message.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            image = Image.open(path, formats=FORMATS)
        except UnidentifiedImageError as error:
            raise InputError.of("image", str(path), "is no image that can be read", _NO_IMAGE) from error
        except Image.DecompressionBombError as error:
            raise InputError.of(
                "image", str(path), f"a page may have at most {MAX_PIXELS // 1_000_000} million pixels", "Crop it."
            ) from error
    with image:
        _check_size(path, *image.size)
        check_png_pixels(path, "image")
        lossy = image.format in ("JPEG", "MPO", "WEBP")
        notes = ("lossy compression mixes the colour channels; use PNG or TIFF for counting",) if lossy else ()
        for number, frame in enumerate(ImageSequence.Iterator(image)):
            frame.load()
            if frame.mode in ("1", "L", "LA", "I", "F") or frame.mode.startswith("I;"):
                raise _gray(path, f"mode {frame.mode}")
            alpha = "A" in frame.mode or "transparency" in frame.info
            array = np.asarray(frame.convert("RGBA" if alpha else "RGB"))
            if magic == b"\x89PNG" and png_depth(path) == 16:
                array = deep_png(path)
            yield _page(path, number, array, is_rgb=True, notes=notes)


def _tiff_pages(path: Path) -> Iterator[MicrographPage]:
    with opened_tiff(path, "image") as file:
        if not file.series:
            raise ValueError("no page")
        if len({(s.pages[0].shape, s.axes) for s in file.series if s.pages[0] is not None}) > 1:
            sizes = ", ".join("×".join(map(str, s.shape)) for s in file.series)
            raise InputError.of(
                "image", f"{path.name}: {sizes}", "all pages of a stack must have one size", "Split or crop the stack."
            )
        number = 0
        for series in file.series:
            for array, is_rgb in _series_pages(path, series):
                yield _page(path, number, array, is_rgb=is_rgb)
                number += 1


def _series_pages(path: Path, series: tifffile.TiffPageSeries) -> Iterator[tuple[NDArray[Any], bool]]:
    first = series.pages[0]
    if first is None:
        raise ValueError("first page is missing")
    sizes = dict(zip(first.axes, first.shape, strict=True))
    if not {"Y", "X"} <= set(first.axes) or not set(first.axes) <= set("YXS"):
        raise InputError.of("image", f"{path.name}: axes {first.axes}", "must be rows, columns and colours", _NO_IMAGE)
    _check_size(path, sizes["X"], sizes["Y"])
    check_claim(path, "image", first.nbytes, DENSEST_TIFF)
    if "S" in first.axes:
        if sizes["S"] not in (3, 4):
            raise _gray(path, f"{sizes['S']} samples a pixel")
        for index in range(len(series.pages)):
            array = _decoded(path, series, index)
            yield (np.moveaxis(array, 0, -1) if first.axes[0] == "S" else array), True
        return
    leading = series.axes[: -len(first.axes)]
    if leading.count("C") != 1 or series.shape[leading.index("C")] < 2:
        raise _gray(path, "one channel")
    shape = series.shape[: len(leading)]
    places = np.moveaxis(np.arange(len(series.pages)).reshape(shape), leading.index("C"), -1)
    for indices in places.reshape(-1, places.shape[-1]):
        yield np.stack([_decoded(path, series, int(k)) for k in indices], axis=-1), False


def _decoded(path: Path, series: tifffile.TiffPageSeries, index: int) -> NDArray[Any]:
    page = series.pages[index]
    if page is None:
        raise ValueError(f"page {index} is missing")
    try:
        return np.asarray(page.asarray())
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
        raise InputError.of(
            "image",
            f"{path.name}: {str(error)[:80]}",
            "this compression cannot be decoded here",
            "Save the stack uncompressed or with ZIP (deflate), or install the imagecodecs package.",
        ) from error
