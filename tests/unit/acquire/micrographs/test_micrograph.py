"""Micrographs: counting, depth, and every kind of file that is refused."""

import struct
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image

from livlab.acquire.micrographs import files as micrograph_files
from livlab.acquire.micrographs import fractions as micrograph
from livlab.acquire.micrographs.fractions import Fraction, Method, PageFractions, Roi, layer_table, measure_files
from livlab.errors import InputError


def two_colour(elastin, collagen, level=200, dtype=np.uint8):
    """Green where elastin, magenta where collagen."""
    image = np.zeros((*elastin.shape, 3), dtype)
    image[..., 1] = level * elastin
    image[..., 0] = image[..., 2] = level * collagen
    return image


def quarter_and_eighth(size=64):
    elastin, collagen = np.zeros((2, size, size), bool)
    elastin[: size // 4] = True
    collagen[size // 2 :, : size // 4] = True
    return elastin, collagen


def measure(path, **method):
    return list(measure_files([path], Method(**method)))


def saved(folder, array, name="a.png"):
    path = folder / name
    Image.fromarray(array).save(path)
    return path


def test_shares_are_counted_exactly(tmp_path):
    (page,) = measure(saved(tmp_path, two_colour(*quarter_and_eighth())))
    assert (page.elastin.value, page.collagen.value, page.overlap, page.pixels) == (0.25, 0.125, 0.0, 4096)


def test_threshold_counts_what_is_above_it(tmp_path):
    for level, expected in ((10, 0.0), (11, 0.25)):
        (page,) = measure(saved(tmp_path, two_colour(*quarter_and_eighth(), level=level)))
        assert page.elastin.value == expected


def test_threshold_effect_is_half_the_change_over_a_fifth_either_way(tmp_path):
    ramp = np.zeros((20, 64, 3), np.uint8)
    ramp[..., 1] = np.repeat(np.arange(20), 64).reshape(20, 64)
    (page,) = measure(saved(tmp_path, ramp))
    # Above 10: 11 … 19, nine rows of 20; above 8: eleven; above 12: seven.
    assert page.elastin.value == 9 / 20
    assert page.elastin.threshold_effect == pytest.approx((11 - 7) / 2 / 20)


def test_a_pixel_above_both_counts_in_both(tmp_path):
    everywhere = np.ones((32, 32), bool)
    half = everywhere.copy()
    half[16:] = False
    (page,) = measure(saved(tmp_path, two_colour(everywhere, half)))
    assert (page.elastin.value, page.collagen.value, page.overlap) == (1.0, 0.5, 0.5)


def test_magenta_needs_red_and_blue(tmp_path):
    image = np.zeros((32, 32, 3), np.uint8)
    image[:8, :, 0] = 255
    image[8:16, :, 2] = 255
    image[16:24, :, [0, 2]] = 255
    path = saved(tmp_path, image)
    assert measure(path)[0].collagen.value == 0.25
    assert measure(path, channels={"elastin": "green", "collagen": "red"})[0].collagen.value == 0.5
    assert measure(path, channels={"elastin": "green", "collagen": "2"})[0].collagen.value == 0.5


def test_region_of_interest(tmp_path):
    path = saved(tmp_path, two_colour(*quarter_and_eighth()))
    (page,) = measure(path, roi=Roi.parse("0,8,64,16"))
    assert (page.elastin.value, page.pixels) == (0.5, 1024)


@pytest.mark.parametrize("roi", ["0,0,65,64", "0,1,64,64", "64,0,1,1", "-1,0,5,5", "0,0,0,5", "0,0,3,3"])
def test_a_region_outside_or_too_small_is_refused(tmp_path, roi):
    path = saved(tmp_path, two_colour(*quarter_and_eighth()))
    with pytest.raises(InputError, match=r"roi|region"):
        measure(path, roi=Roi.parse(roi))
    with pytest.raises(InputError, match="four whole numbers"):
        Roi.parse("1,2,3")


def test_rgba_leaves_transparent_pixels_out(tmp_path):
    image = two_colour(*quarter_and_eighth())
    alpha = np.full((64, 64, 1), 255, np.uint8)
    opaque = saved(tmp_path, np.concatenate([image, alpha], axis=2), "opaque.png")
    assert measure(opaque)[0].elastin.value == 0.25
    assert measure(opaque)[0].pixels == 4096
    alpha[32:] = 0
    cut = saved(tmp_path, np.concatenate([image, alpha], axis=2), "cut.png")
    (page,) = measure(cut)
    assert (page.elastin.value, page.pixels) == (0.5, 2048)
    assert any("transparent" in w for w in page.warnings)


def test_palette_png_is_read_by_its_colours(tmp_path):
    path = tmp_path / "p.png"
    Image.fromarray(two_colour(*quarter_and_eighth())).convert("P").save(path)
    assert measure(path)[0].elastin.value == 0.25


def test_sixteen_bit_png_keeps_its_bits(tmp_path):
    """2600 of 65535 is above 10 of 255 (2570), 2560 is not; cut to 8 bits both would read 10."""
    for level, expected in ((2600, 0.25), (2560, 0.0)):
        path = tmp_path / "deep.png"
        path.write_bytes(deep_png(two_colour(*quarter_and_eighth(), level=level, dtype=np.uint16)))
        assert measure(path)[0].elastin.value == expected


def test_sixteen_bit_tiff_and_full_scale(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, two_colour(*quarter_and_eighth(), level=200, dtype=np.uint16), photometric="rgb")
    assert measure(path)[0].elastin.value == 0.0
    (page,) = measure(path, full_scale=4095.0)
    assert page.elastin.value == 0.25
    tifffile.imwrite(path, two_colour(*quarter_and_eighth(), level=4000, dtype=np.uint16), photometric="rgb")
    assert any("12 bits" in w for w in measure(path)[0].warnings)
    with pytest.raises(InputError, match="exceeds the full scale"):
        measure(path, full_scale=1023.0)


@pytest.mark.parametrize("kind", ["rgb", "planar", "imagej rgb", "ome channels", "separate pages", "zip"])
def test_stacks_of_every_usual_form(tmp_path, kind):
    path = tmp_path / "s.tif"
    elastin, collagen = quarter_and_eighth()
    pages = [two_colour(elastin, collagen), two_colour(~elastin, collagen), two_colour(elastin & False, collagen)]
    channels = {}
    if kind == "rgb":
        tifffile.imwrite(path, np.stack(pages), photometric="rgb")
    elif kind == "zip":
        tifffile.imwrite(path, np.stack(pages), photometric="rgb", compression="zlib")
    elif kind == "imagej rgb":
        tifffile.imwrite(path, np.stack(pages), imagej=True)
    elif kind == "planar":
        planar = np.moveaxis(np.stack(pages), -1, 1)
        tifffile.imwrite(path, planar, photometric="rgb", planarconfig="separate")
    elif kind == "separate pages":
        with tifffile.TiffWriter(path) as writer:
            for page in pages:
                writer.write(page, photometric="rgb", metadata=None)
    else:
        two = np.stack([np.stack([p[..., 1], p[..., 0]]) for p in pages])
        tifffile.imwrite(path, two, ome=True, metadata={"axes": "ZCYX"})
        channels = {"channels": {"elastin": "0", "collagen": "1"}}
    found = measure(path, **channels)
    assert [p.elastin.value for p in found] == [0.25, 0.75, 0.0]
    assert [p.collagen.value for p in found] == [0.125] * 3
    assert [p.number for p in found] == [0, 1, 2]


def test_numbered_channels_have_no_colours(tmp_path):
    path = tmp_path / "c.tif"
    tifffile.imwrite(path, np.zeros((2, 32, 32), np.uint8), metadata={"axes": "CYX"})
    with pytest.raises(InputError, match="has 0 … 1"):
        measure(path)


def test_all_black_is_nothing_and_otsu_says_so(tmp_path):
    path = saved(tmp_path, np.zeros((40, 40, 3), np.uint8))
    (page,) = measure(path)
    assert page.elastin.value == page.collagen.value == 0.0
    assert 0 < page.elastin.standard_error < 2 / 1600
    with pytest.raises(InputError, match="Otsu's method needs two values"):
        measure(path, threshold="otsu")


def test_saturation_leakage_and_background_are_said(tmp_path):
    elastin, collagen = quarter_and_eighth()
    assert any("saturated" in w for w in measure(saved(tmp_path, two_colour(elastin, collagen, 255)))[0].warnings)
    leaking = two_colour(elastin, collagen)
    leaking[..., [0, 2]] = np.maximum(leaking[..., [0, 2]], leaking[..., 1:2] // 5)
    assert any("leak" in w for w in measure(saved(tmp_path, leaking))[0].warnings)
    clean = two_colour(elastin, collagen)
    assert not any("leak" in w or "saturated" in w for w in measure(saved(tmp_path, clean))[0].warnings)
    hazy = np.maximum(clean, 14).astype(np.uint8)
    assert any("background" in w for w in measure(saved(tmp_path, hazy))[0].warnings)


def test_otsu_on_noise_alone_is_flagged(tmp_path):
    noise = np.clip(np.random.default_rng(0).normal(100, 10, (128, 128, 3)), 0, 255).astype(np.uint8)
    assert any("no second class" in w for w in measure(saved(tmp_path, noise), threshold="otsu")[0].warnings)


def test_jpeg_is_read_with_a_word_of_warning(tmp_path):
    path = tmp_path / "a.jpg"
    Image.fromarray(two_colour(*quarter_and_eighth())).save(path, quality=95)
    (page,) = measure(path)
    assert any("lossy" in w for w in page.warnings)


def write(path, data):
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("cut", [3, 20, 60, 0.5, 0.98])
@pytest.mark.parametrize("kind", ["png", "deep.png", "tif", "zip.tif", "jpg"])
def test_truncated_files_are_refused(tmp_path, kind, cut):
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    whole = tmp_path / f"whole.{kind.rsplit('.')[-1]}"
    if kind == "deep.png":
        whole.write_bytes(deep_png(noise.astype(np.uint16) * 257))
    elif kind in ("tif", "zip.tif"):
        tifffile.imwrite(whole, noise, photometric="rgb", compression="zlib" if kind == "zip.tif" else None)
    else:
        Image.fromarray(noise).save(whole)
    assert len(measure(whole)) == 1
    data = whole.read_bytes()
    with pytest.raises(InputError, match=r"decoded|no image|truncated|damaged"):
        measure(write(tmp_path / f"cut.{kind}", data[: cut if isinstance(cut, int) else int(cut * len(data))]))


def test_what_is_no_two_colour_image_is_refused(tmp_path):
    square = np.zeros((32, 32), np.uint8)
    cases = [
        (write(tmp_path / "t.png", b"not an image at all"), "no image"),
        (write(tmp_path / "empty.png", b""), "no image"),
        (tmp_path / "absent.png", "is not a file"),
        (tmp_path, "is not a file"),
        (saved(tmp_path, square, "gray.png"), "no colour"),
        (saved(tmp_path, square.astype(np.uint16), "gray16.png"), "no colour"),
    ]
    for name, array, kwargs, says in [
        ("gray.tif", square, {}, "no colour"),
        ("stack.tif", np.zeros((5, 32, 32), np.uint8), {"photometric": "minisblack"}, "no colour"),
        ("signed.tif", np.zeros((32, 32, 3), np.int16), {"photometric": "rgb"}, "unsigned"),
        ("nan.tif", np.full((32, 32, 3), np.nan, np.float32), {"photometric": "rgb"}, "NaN"),
        ("big.tif", np.full((32, 32, 3), 7, np.float32), {"photometric": "rgb"}, "within \\[0, 1\\]"),
    ]:
        tifffile.imwrite(tmp_path / name, array, **kwargs)
        cases.append((tmp_path / name, says))
    with tifffile.TiffWriter(tmp_path / "mixed.tif") as writer:
        writer.write(np.zeros((32, 32, 3), np.uint8), photometric="rgb")
        writer.write(np.zeros((32, 40, 3), np.uint8), photometric="rgb")
    cases.append((tmp_path / "mixed.tif", "one size"))
    for path, says in cases:
        with pytest.raises(InputError, match=says):
            measure(path)


def test_float_tiff_within_one_is_read(tmp_path):
    path = tmp_path / "f.tif"
    image = two_colour(*quarter_and_eighth(), level=1).astype(np.float32) * 0.5
    tifffile.imwrite(path, image, photometric="rgb")
    assert measure(path)[0].elastin.value == 0.25


def test_huge_pages_are_refused_before_they_are_decoded(tmp_path, monkeypatch):
    bomb = write(tmp_path / "bomb.png", png_header(60_000, 60_000))
    with pytest.raises(InputError, match="100 million pixels"):
        measure(bomb)
    with pytest.raises(InputError, match="100 million pixels"):
        measure(write(tmp_path / "large.png", png_header(20_000, 6_000)))
    monkeypatch.setattr(micrograph_files, "MAX_PIXELS", 1000)
    tifffile.imwrite(tmp_path / "l.tif", np.zeros((40, 40, 3), np.uint8), photometric="rgb")
    with pytest.raises(InputError, match="40×40"):
        measure(tmp_path / "l.tif")


def test_method_is_checked():
    for arguments in [
        {"threshold": 255.0},
        {"threshold": -1.0},
        {"full_scale": 0.0},
        {"channels": {"elastin": "green"}},
    ]:
        with pytest.raises(InputError):
            Method(**arguments)


def page(elastin, collagen, error=0.01, shape=(64, 64)):
    made = [Fraction(v, error, 10.0, 0.0) for v in (elastin, collagen)]
    return PageFractions("s", 0, *made, 0.0, 4096, shape, ())


TABLE_6_1 = [(0.051, 0.192), (0.189, 0.110), (0.254, 0.001), (0.087, 0.007)]


def test_one_page_a_sublayer_is_the_thesis_table():
    table = layer_table([page(*row) for row in TABLE_6_1], edges=[0, 0.65, 0.72, 0.83, 1])
    assert table.elastin.tolist() == [row[0] for row in TABLE_6_1]
    assert table.collagen.tolist() == [row[1] for row in TABLE_6_1]
    assert table.edges.tolist() == [0, 0.65, 0.72, 0.83, 1]


def test_depths_are_interpolated_and_averaged():
    pages = [page(0.0, 0.4), page(0.2, 0.0)]
    table = layer_table(pages, depths_um=[20.0, 60.0], thickness_um=80.0, edges=[0, 0.25, 0.75, 1])
    assert table.elastin == pytest.approx([0.0, 0.1, 0.2])
    assert table.collagen == pytest.approx([0.4, 0.2, 0.0])
    assert table.elastin_error == pytest.approx([0.01, 0.01 / np.sqrt(2), 0.01])


def test_without_edges_sublayers_part_half_way():
    table = layer_table([page(0.1, 0.1)] * 3, depths_um=[0.0, 40.0, 100.0])
    assert table.edges.tolist() == [0.0, 0.2, 0.7, 1.0]
    assert table.elastin == pytest.approx([0.1] * 3)


def test_a_single_page_fills_the_layer():
    table = layer_table([page(0.1, 0.2)])
    assert (table.edges.tolist(), table.elastin.tolist()) == ([0.0, 1.0], [0.1])


@pytest.mark.parametrize(
    ("pages", "arguments", "says"),
    [
        (0, {}, "at least one"),
        (2, {}, "need depths or sublayers"),
        (2, {"edges": [0, 1]}, "3 shares"),
        (2, {"edges": [0, 0.7, 0.6]}, "rise from 0 to 1"),
        (2, {"edges": [0, 0.7, 100]}, "rise from 0 to 1"),
        (2, {"edges": [0.1, 0.7, 1]}, "rise from 0 to 1"),
        (2, {"depths_um": [0.0]}, "rising depths"),
        (2, {"depths_um": [5.0, 5.0]}, "rising depths"),
        (2, {"depths_um": [0.0, float("nan")]}, "rising depths"),
        (2, {"depths_um": [-1.0, 5.0]}, "within 0"),
        (2, {"depths_um": [0.0, 5.0], "thickness_um": 4.0}, "within 0"),
        (1, {"depths_um": [0.0]}, "within 0"),
    ],
)
def test_bad_depths_are_refused(pages, arguments, says):
    with pytest.raises(InputError, match=says):
        layer_table([page(0.1, 0.2)] * pages, **arguments)


def test_pages_of_two_sizes_are_no_stack():
    with pytest.raises(InputError, match="one size"):
        layer_table([page(0.1, 0.2), page(0.1, 0.2, shape=(64, 65))], depths_um=[0.0, 10.0])


def test_mean_matrix_by_quadrature():
    rng = np.random.default_rng(2)
    depths, edges = np.array([0.1, 0.33, 0.34, 0.9]), np.array([0.0, 0.2, 0.5, 1.0])
    values = rng.random(4)
    got = micrograph.mean_matrix(depths, edges) @ values
    for k in range(3):
        z = np.linspace(edges[k], edges[k + 1], 200_001)
        assert got[k] == pytest.approx(np.trapezoid(np.interp(z, depths, values), z) / np.ptp(z), abs=1e-8)


def deep_png(array):
    """A 16-bit RGB PNG: the format is simple enough to write by hand, and no Pillow mode holds it."""
    height, width, _ = array.shape
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in array)
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def png_header(width, height):
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 100))


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
