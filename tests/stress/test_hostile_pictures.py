"""Pictures and segmentations whose headers claim what is not there: chunks, directories of pages, extensions."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from livlab.acquire.micrographs.files import read_pages
from livlab.acquire.photographs.read import read_photograph
from livlab.core.picture_files import check_png, check_png_pixels, check_tiff
from livlab.errors import InputError
from livlab.model.shapes import read_volume

MOST = 64 << 20
"""Bytes that a reader may set aside for one of these files, none of which has a thousand."""


def _slices(path: Path) -> object:
    return read_volume(path.parent, spacing_mm=(1.0,))


def _micrograph(path: Path) -> object:
    return list(read_pages(path))


READERS = [read_photograph, _micrograph, _slices]


def refused(read: Callable[[Path], object], path: Path) -> str:
    """The message of the refusal, for which little memory was asked."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            read(path)
        assert tracemalloc.get_traced_memory()[1] < MOST
    finally:
        tracemalloc.stop()
    assert caught.value.remedy
    return caught.value.message


def _chunk(name: bytes, content: bytes, length: int | None = None) -> bytes:
    head = struct.pack(">I", len(content) if length is None else length) + name + content
    return head + struct.pack(">I", zlib.crc32(name + content))


def png(length: int | None = None, side: int = 4) -> bytes:
    """Grey, 8 bits; `length` is what its pixels' chunk says that it has, `side` what the header says."""
    pixels = zlib.compress(bytes(4 * 5))
    head = _chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + _chunk(b"IDAT", pixels, length) + _chunk(b"IEND", b"")


@pytest.mark.parametrize("read", READERS)
def test_a_chunk_of_a_png_is_not_longer_than_its_file(read: Callable[[Path], object], tmp_path: Path) -> None:
    Image.new("L", (4, 4)).save(tmp_path / "1.png")
    path = tmp_path / "0.png"
    path.write_bytes(png())
    check_png(path, "picture")
    for length in (0xFDFFFF18, 400):
        path.write_bytes(png(length))
        assert "'IDAT'" in refused(read, path)


@pytest.mark.parametrize("read", READERS)
def test_a_small_png_does_not_claim_a_large_picture(read: Callable[[Path], object], tmp_path: Path) -> None:
    Image.new("L", (4, 4)).save(tmp_path / "1.png")
    (tmp_path / "0.png").write_bytes(png(side=9000))
    assert "81000000 bytes of pixels" in refused(read, tmp_path / "0.png")


@pytest.mark.parametrize(("mode", "bits"), [("1", 1), ("L", 8), ("LA", 16), ("RGB", 24), ("RGBA", 32), ("I;16", 16)])
def test_what_is_packed_best_fits_its_file(mode: str, bits: int, tmp_path: Path) -> None:
    Image.new(mode, (3001, 3000)).save(tmp_path / "0.png", compress_level=9)
    check_png(tmp_path / "0.png", "picture")
    check_png_pixels(tmp_path / "0.png", "picture")
    packed = 3001 * 3000 * bits / 8 / (tmp_path / "0.png").stat().st_size
    assert 800 < packed < 1100  # close to the bound, and below


def tiff(pages: int, *, big: bool = False, order: str = "<") -> bytearray:
    out = io.BytesIO()
    with tifffile.TiffWriter(out, bigtiff=big, byteorder=order) as writer:  # type: ignore[arg-type]
        for _ in range(pages):
            writer.write(np.zeros((8, 6, 3), np.uint8), photometric="rgb", contiguous=False, metadata=None)
    return bytearray(out.getvalue())


def _ends(content: bytes) -> tuple[list[int], list[int]]:
    """Where the directories of pages are, and where each names the next."""
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        places = [page.offset for page in file.pages]
        classic = not file.is_bigtiff
        many, entry, form = (2, 12, file.byteorder + "H") if classic else (8, 20, file.byteorder + "Q")
        return places, [p + many + entry * struct.unpack_from(form, content, p)[0] for p in places]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(("pages", "back"), [(1, 0), (3, 1), (150, 0)])
def test_pages_of_a_tiff_do_not_go_round(pages: int, back: int, read: Callable[[Path], object], tmp_path: Path) -> None:
    content = tiff(pages)
    places, ends = _ends(content)
    struct.pack_into("<I", content, ends[-1], places[back])
    path = tmp_path / "0.tif"
    path.write_bytes(content)
    (tmp_path / "1.tif").write_bytes(tiff(1))
    message = refused(read, path)
    assert "must not come twice" in message
    assert f"at byte {places[back]}" in message


@pytest.mark.parametrize(("big", "order"), [(False, "<"), (False, ">"), (True, "<"), (True, ">")])
def test_a_chain_of_directories_is_followed_in_every_layout(big: bool, order: str, tmp_path: Path) -> None:
    content = tiff(12, big=big, order=order)
    places, ends = _ends(content)
    (tmp_path / "a.tif").write_bytes(content)
    check_tiff(tmp_path / "a.tif", "picture")
    struct.pack_into(order + ("Q" if big else "I"), content, ends[-1], places[-1])
    (tmp_path / "a.tif").write_bytes(content)
    with pytest.raises(InputError, match=f"at byte {places[-1]}.*twice"):
        check_tiff(tmp_path / "a.tif", "picture")


def test_directories_of_a_tiff_do_not_overlap(tmp_path: Path) -> None:
    """A directory of 600 entries every four bytes, each of which names the one four bytes on as the next."""
    many = 600
    content = bytearray(struct.pack("<2sHI", b"II", 42, 8) + bytes(12 * many + 4 * many + 8))
    for at in range(8, 8 + 4 * many, 4):
        struct.pack_into("<H", content, at, many)
        struct.pack_into("<I", content, at + 2 + 12 * many, at + 4)
    (tmp_path / "a.tif").write_bytes(content)
    assert "overlap" in refused(read_photograph, tmp_path / "a.tif")


@pytest.mark.parametrize("read", READERS)
def test_a_small_tiff_does_not_claim_a_large_picture(read: Callable[[Path], object], tmp_path: Path) -> None:
    content = tiff(1)
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        for name in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            tag = file.pages.first.tags[name]
            struct.pack_into("<H" if tag.dtype == 3 else "<I", content, tag.valueoffset, 9000)
    (tmp_path / "0.tif").write_bytes(content)
    (tmp_path / "1.tif").write_bytes(tiff(1))
    assert f"{9000 * 9000 * 3} bytes of pixels" in refused(read, tmp_path / "0.tif")


@pytest.mark.parametrize("version", [1, 2])
def test_an_extension_of_a_nifti_is_not_taken_at_its_word(version: int, tmp_path: Path) -> None:
    import nibabel

    values = np.zeros((5, 4, 3), np.uint8)
    values[1:4, 1:3, 1] = 1
    image = (nibabel.Nifti1Image if version == 1 else nibabel.Nifti2Image)(values, np.eye(4))
    image.header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", b"x" * 30))
    content = bytearray(image.to_bytes())
    at = 352 if version == 1 else 544
    (length,) = struct.unpack_from("<i", content, at)
    assert length == 48
    for told in (length, 0x7D7D7D7D):
        struct.pack_into("<i", content, at, told)
        (tmp_path / "a.nii").write_bytes(content)
        tracemalloc.start()
        found = read_volume(tmp_path / "a.nii")
        assert tracemalloc.get_traced_memory()[1] < MOST
        tracemalloc.stop()
        np.testing.assert_array_equal(found.inside, values > 0)


def ome(sizes: str, data: str, more: str = "") -> bytes:
    """Two grey pages of 6×8 and what OME-XML says of them."""
    text = '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">'
    text += f'<Pixels DimensionOrder="XYCZT" ID="Pixels:0" Type="uint8" {sizes}>{data}</Pixels></Image>{more}</OME>'
    out = io.BytesIO()
    with tifffile.TiffWriter(out) as writer:
        for words in (text, None):
            writer.write(np.zeros((8, 6), np.uint8), description=words, metadata=None, contiguous=False)
    return out.getvalue()


REAL = 'SizeX="6" SizeY="8" SizeC="2" SizeZ="1" SizeT="1"'
ALONG = (
    '<StructuredAnnotations><A ID="A" Namespace="modulo"><Value><M><ModuloAlongZ Start="0" End="{}"/></M></Value></A>'
)
ALONG += "</StructuredAnnotations>"


@pytest.mark.parametrize(
    ("sizes", "data", "more"),
    [
        (REAL.replace('SizeZ="1"', 'SizeZ="20000000"'), '<TiffData IFD="0" PlaneCount="1"/>', ""),
        (REAL.replace('SizeX="6"', 'SizeX="60000000"'), '<TiffData IFD="0" PlaneCount="1"/>', ""),
        (REAL, '<TiffData IFD="0" PlaneCount="20000000"/>', ""),
        (REAL, '<TiffData IFD="0" PlaneCount="2"/>', ALONG.format(2 * 10**7)),
        (REAL.replace('SizeZ="1"', 'SizeZ="many"'), '<TiffData IFD="0" PlaneCount="1"/>', ""),
    ],
)
def test_words_of_a_tiff_do_not_claim_planes_without_end(sizes: str, data: str, more: str, tmp_path: Path) -> None:
    path = tmp_path / "0.tif"
    path.write_bytes(ome(REAL, '<TiffData IFD="0" PlaneCount="2"/>'))
    assert [page.channels.shape for page in read_pages(path)] == [(8, 6, 2)]
    path.write_bytes(ome(sizes, data, more))
    assert "planes" in refused(_micrograph, path)


def test_words_of_a_tiff_open_no_other_file(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "other.tif").write_bytes(ome(REAL, '<TiffData IFD="0" PlaneCount="2"/>'))
    data = '<TiffData IFD="0" PlaneCount="2"><UUID FileName="../other.tif">urn:uuid:1</UUID></TiffData>'
    (tmp_path / "in" / "0.tif").write_bytes(ome(REAL, data))
    assert "one channel" in refused(_micrograph, tmp_path / "in" / "0.tif")
