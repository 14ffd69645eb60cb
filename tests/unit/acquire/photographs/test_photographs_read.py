"""Files of photographs: every format read as stored, bad ones refused with a reason."""

import struct
import zlib

import numpy as np
import pytest
import tifffile
from deep_pictures import deep_png
from PIL import Image

from fuzz.seeds import dng
from livlab.acquire.photographs.read import MAX_PIXELS, Exposure, read_photograph
from livlab.errors import InputError

RNG = np.random.default_rng(7)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tga"])
def test_8_bit_rgb_comes_back_as_written(tmp_path, suffix):
    array = RNG.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    Image.fromarray(array).save(tmp_path / f"a{suffix}")
    found = read_photograph(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(found.values, array)
    assert found.full_scale == 255


def test_16_bit_rgb_png_is_not_cut_to_8_bits(tmp_path):
    array = RNG.integers(0, 65536, (20, 30, 3), dtype=np.uint16)
    deep_png(tmp_path / "a.png", array)
    found = read_photograph(tmp_path / "a.png")
    np.testing.assert_array_equal(found.values, array)
    assert (found.full_scale, found.linear) == (65535, None)


def test_grey_in_8_and_16_bits(tmp_path):
    deep = RNG.integers(0, 65536, (20, 30), dtype=np.uint16)
    Image.fromarray(deep).save(tmp_path / "a.png")
    tifffile.imwrite(tmp_path / "a.tif", deep)
    for name in ("a.png", "a.tif"):
        found = read_photograph(tmp_path / name)
        np.testing.assert_array_equal(found.values[..., 0], deep)
        assert found.values.dtype == np.uint16


def test_16_bit_rgb_tiff_with_exif(tmp_path):
    array = RNG.integers(0, 65536, (20, 30, 3), dtype=np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", array, photometric="rgb", extratags=[(33434, 5, 1, (1, 50), True)])
    found = read_photograph(tmp_path / "a.tif")
    np.testing.assert_array_equal(found.values, array)
    assert found.exposure.value == pytest.approx(0.02)


def test_exif_of_a_jpeg(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({33434: (1, 125), 34855: 200, 33437: (4, 1)})
    Image.fromarray(RNG.integers(0, 256, (20, 30, 3), dtype=np.uint8)).save(tmp_path / "a.jpg", exif=exif)
    found = read_photograph(tmp_path / "a.jpg")
    assert (found.exposure.iso, found.exposure.f_number) == (200, 4)
    assert found.exposure.value == pytest.approx(1 / 125 * 2 / 16)
    assert found.linear is False
    assert "lossy" in found.notes[0]


def test_exposure_without_a_time_has_no_value():
    assert Exposure(iso=100).value is None


def test_floating_point_tiff_and_exr_keep_nan(tmp_path):
    import OpenEXR

    array = RNG.random((20, 30, 3)).astype(np.float32) * 5
    array[3, 4] = np.nan
    tifffile.imwrite(tmp_path / "a.tif", array, photometric="rgb")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": array}).write(str(tmp_path / "a.exr"))
    OpenEXR.File(header, {"Y": array[..., 0].copy()}).write(str(tmp_path / "g.exr"))
    for name in ("a.tif", "a.exr"):
        found = read_photograph(tmp_path / name)
        np.testing.assert_array_equal(found.values, array)
        assert found.full_scale == np.inf
    assert read_photograph(tmp_path / "a.exr").linear is True
    np.testing.assert_array_equal(read_photograph(tmp_path / "g.exr").values[..., 0], array[..., 0])


def test_a_gamma_chunk_tells_the_encoding(tmp_path):
    array = RNG.integers(0, 65536, (8, 8, 3), dtype=np.uint16)
    for gamma, linear in ((1.0, True), (0.45455, False)):
        deep_png(tmp_path / "a.png", array, gamma)
        assert read_photograph(tmp_path / "a.png").linear is linear


@pytest.mark.parametrize("brightest", [0.9, 0.3])
def test_raw_is_linear_black_subtracted_and_not_balanced(tmp_path, brightest):
    level = np.linspace(0.05, brightest, 96)
    cfa = np.zeros((64, 96), np.uint16)
    cfa[:] = (512 + level * (16383 - 512)).astype(np.uint16)
    cfa[0::2, 0::2] = (512 + 0.5 * level[0::2] * (16383 - 512)).astype(np.uint16)
    (tmp_path / "a.dng").write_bytes(dng(cfa))
    found = read_photograph(tmp_path / "a.dng")
    share = found.values / found.full_scale
    inner = np.s_[32, 4:-4]
    # However bright the brightest pixel is, the scale stays the sensor's own.
    np.testing.assert_allclose(share[inner][:, 2], level[4:-4], atol=0.006)
    np.testing.assert_allclose(share[inner][:, 0], 0.5 * level[4:-4], atol=0.006)
    assert found.linear is True
    assert found.exposure.seconds == pytest.approx(0.02)


def png_header(columns, rows):
    head = b"IHDR" + struct.pack(">IIBBBBB", columns, rows, 16, 2, 0, 0, 0)
    data = b"IDAT" + zlib.compress(b"\0" * 99)
    chunks = (struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in (head, data, b"IEND"))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def test_400_megapixels_are_refused_from_the_header(tmp_path):
    (tmp_path / "a.png").write_bytes(png_header(20000, 20000))
    with pytest.raises(InputError, match="million pixels"):
        read_photograph(tmp_path / "a.png")
    # A TIFF that says so, without its data.
    entries = [(256, 4, 20000), (257, 4, 20000), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1)]
    entries += [(278, 4, 20000), (279, 4, 100)]
    body = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
    head = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(entries))
    (tmp_path / "a.tif").write_bytes(head + body + struct.pack("<I", 0) + b"\0" * 200)
    with pytest.raises(InputError, match="million pixels"):
        read_photograph(tmp_path / "a.tif")
    assert MAX_PIXELS < 20000 * 20000


def test_truncated_files_are_refused(tmp_path):
    import OpenEXR

    array = RNG.integers(0, 65536, (60, 70, 3), dtype=np.uint16)
    deep_png(tmp_path / "a.png", array)
    tifffile.imwrite(tmp_path / "a.tif", array, photometric="rgb")
    Image.fromarray((array >> 8).astype(np.uint8)).save(tmp_path / "a.tga")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": array.astype(np.float32)}).write(str(tmp_path / "a.exr"))
    (tmp_path / "a.dng").write_bytes(dng(array[..., 0]))
    for name in ("a.png", "a.tif", "a.tga", "a.exr", "a.dng"):
        whole = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(whole[: len(whole) * 2 // 3])
        with pytest.raises(InputError, match=r"truncated|damaged|cannot be decoded"):
            read_photograph(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.png", b"", "no image"),
        ("a.png", b"this is text", "no image"),
        ("a.exr", b"\x76\x2f\x31\x01junk", "cannot be decoded"),
        ("a.nef", b"junk", "cannot be decoded"),
        ("a.tif", b"II*\0junk", "cannot be decoded"),
    ],
)
def test_what_is_no_image_is_refused(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_photograph(tmp_path / name)


def test_missing_and_several_pages(tmp_path):
    with pytest.raises(InputError, match="is not a file"):
        read_photograph(tmp_path / "none.png")
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((3, 8, 8), np.uint8), photometric="minisblack")
    with pytest.raises(InputError, match="one picture"):
        read_photograph(tmp_path / "a.tif")
