"""What picture files claim of themselves, held against their length before a library takes them at their word."""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from livlab.core.files import DENSEST
from livlab.errors import InputError

if TYPE_CHECKING:
    from xml.etree import ElementTree

    import tifffile
    from numpy.typing import NDArray

PNG = b"\x89PNG\r\n\x1a\n"

DENSEST_TIFF = 10_000
"""Bytes that a byte of a TIFF's pixels can stand for, at most: LZMA packs 10⁸ zeros 6900 times, LZW 2600 times."""

MOST_PLANES = 100_000
"""Of a stack, by what its OME-XML says."""

_LEADING = ("SizeC", "SizeZ", "SizeT")

_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Of a pixel, by PNG's colour type."""

_DAMAGED = "It is damaged or cut short: copy or export it again."


def check_png(path: Path, field: str) -> None:
    """Hold the lengths of a PNG's chunks against its own length.

    Pillow and libpng set aside what a chunk's length says (up to 4 GiB), and only then look for the bytes. What is no
    PNG passes.

    Raises
    ------
    InputError
        A chunk reaches beyond the end of the file.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        if stream.read(len(PNG)) != PNG:
            return
        at = len(PNG)
        while at + 8 <= size:
            stream.seek(at)
            length, name = struct.unpack(">I4s", stream.read(8))
            if at + 12 + length > size:
                claim = f"{path.name}: chunk {name.decode('ascii', 'replace')!r} of {length} bytes"
                raise InputError.of(field, claim, f"must fit the file, which has {size}", _DAMAGED)
            if name == b"IEND":
                return
            at += 12 + length


def check_png_pixels(path: Path, field: str) -> None:
    """Raise `InputError` where a PNG's header claims more pixels than so short a file can hold; no PNG passes, too."""
    with path.open("rb") as stream:
        head = stream.read(26)
    if head.startswith(PNG) and len(head) == 26:
        width, height, depth, colour = struct.unpack_from(">IIBB", head, 16)
        check_claim(path, field, height * (width * depth * _SAMPLES.get(colour, 1) // 8), DENSEST)


def png_depth(path: Path) -> int:
    """Bits a channel of a PNG that is there."""
    with path.open("rb") as stream:
        return stream.read(25)[24]


def deep_png(path: Path) -> NDArray[Any]:
    """16-bit colour PNG, which Pillow would cut to 8 bits; Pillow has by now found the file to be whole."""
    import cv2
    import numpy as np

    array = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if array is None or array.ndim != 3:
        raise ValueError("16-bit PNG not understood")
    return np.asarray(array[..., [2, 1, 0, 3][: array.shape[2]]])


def check_claim(path: Path, field: str, claimed: int, densest: int) -> None:
    """Raise `InputError` where a header claims more bytes of pixels than its file can hold, however well packed."""
    size = path.stat().st_size
    if claimed > densest * size:
        bound = f"must fit the file, whose {size} bytes can hold at most {densest * size}"
        raise InputError.of(field, f"{path.name}: {claimed} bytes of pixels", bound, _DAMAGED)


def png_size(path: Path) -> tuple[int, int]:
    """Width and height from a PNG's header; 0, 0 of what is no PNG."""
    with path.open("rb") as stream:
        head = stream.read(24)
    if len(head) < 24 or head[:8] != PNG:
        return 0, 0
    return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")


def check_tiff(path: Path, field: str) -> None:
    """Follow the chain of a TIFF's directories once, to its end.

    tifffile finds a ring of directories by chance only, and reads one that overlap as often as they are named.

    Raises
    ------
    InputError
        A directory comes twice, or all of them together are longer than the file: then some overlap.
    """
    size = path.stat().st_size
    seen: set[int] = set()
    tables = 0
    with path.open("rb") as stream:
        for at, length in _directories(stream, size):
            tables += length
            if at in seen or tables > size:
                bound = "must not come twice" if at in seen else "must not overlap another"
                raise InputError.of(field, f"{path.name}: directory of a page at byte {at}", bound, _DAMAGED)
            seen.add(at)


def _directories(stream: BinaryIO, size: int) -> Iterator[tuple[int, int]]:
    """Offset and length of each directory of pages; ends where the chain leads out of the file."""
    head = stream.read(16)
    order = "<" if head[:2] == b"II" else ">"
    big = head[2:4] in (b"+\0", b"\0+")
    number, count, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    places = struct.calcsize(number)
    start = head[8:16] if big else head[4:8]
    many = struct.calcsize(order + count)
    while len(start) == places:
        (at,) = struct.unpack(order + number, start)
        if not 0 < at < size:
            return
        stream.seek(at)
        found = stream.read(many)
        if len(found) < many:
            return
        length = many + entry * struct.unpack(order + count, found)[0] + places
        yield at, length
        if at + length > size:
            return
        stream.seek(at + length - places)
        start = stream.read(places)


@contextlib.contextmanager
def opened_tiff(path: Path, field: str) -> Iterator[tifffile.TiffFile]:
    """A TIFF whose chain of pages ends; what it says of other files is not followed.

    Raises
    ------
    InputError
        See `check_tiff`; or the OME-XML in it counts what cannot be there.
    """
    import tifffile

    check_tiff(path, field)
    # Series of these kinds are put together from files beside, or out of words in the file that name any others.
    with tifffile.TiffFile(path, _multifile=False, is_mmstack=False, is_ndtiff=False) as file:
        if file.is_ome:
            smallest = min((page.imagewidth * page.imagelength for page in file.pages), default=1)  # type: ignore[union-attr]
            _check_ome(path, field, str(file.ome_metadata), max(smallest, 1))
        yield file


def _check_ome(path: Path, field: str, text: str, smallest: int) -> None:
    """Refuse OME-XML that counts too many planes of at least `smallest` pixels: tifffile makes a list of them all."""
    from xml.etree import ElementTree

    try:
        planes = sum(_planes(part, smallest) for part in ElementTree.fromstring(text).iter())
    except ElementTree.ParseError:
        return  # tifffile then takes the pages as they come
    except (ValueError, OverflowError, ZeroDivisionError) as error:
        raise InputError.of(field, f"{path.name}: OME-XML", f"must count its planes ({error})", _DAMAGED) from error
    if planes > MOST_PLANES:
        claim = f"{path.name}: {planes} planes in its OME-XML"
        raise InputError.of(field, claim, f"must be at most {MOST_PLANES}", "Split the stack, or export it again.")


def _planes(part: ElementTree.Element, smallest: int) -> int:
    kind, said = part.tag.rpartition("}")[2], part.attrib
    if kind == "Pixels":
        sizes = {name: abs(int(value)) for name, value in said.items() if name in ("SizeX", "SizeY", *_LEADING)}
        leading = math.prod(sizes.get(name, 1) for name in _LEADING)
        return max(leading, math.prod(sizes.values()) // smallest)
    if kind == "TiffData":
        return max(abs(int(said.get(name, 0))) for name in ("NumPlanes", "PlaneCount"))
    if kind.startswith("ModuloAlong") and "Start" in said:
        start, end, step = (float(said.get(name, 1)) for name in ("Start", "End", "Step"))
        return math.ceil(abs((end - start) / step))
    return 0
