from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from livlab.errors import EnvironmentProblem, InputError
from livlab.model.colour import cie_rgb, decode_srgb, encode_srgb, write_exr, write_png

GRID = np.arange(400.0, 731.0, 10.0)


@pytest.fixture
def spectral() -> xr.DataArray:
    values = np.random.default_rng(2).random((5, 7, len(GRID))).astype(np.float32)
    return xr.DataArray(values, dims=("row", "column", "wavelength"), coords={"wavelength": GRID})


def test_exr_keeps_every_float_and_says_what_it_holds(tmp_path, spectral):
    import OpenEXR

    rgb = 3 * cie_rgb(spectral) - 1
    path = write_exr(tmp_path / "image.exr", rgb, spectral=spectral, metadata={"illuminant": "D65", "kappa_nm": 20})
    with OpenEXR.File(str(path)) as file:
        assert np.array_equal(file.channels()["RGB"].pixels, rgb.to_numpy().astype(np.float32))
        header = file.header()
        assert header["chromaticities"] == pytest.approx((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329), abs=1e-6)
        assert header["illuminant"] == "D65"
        assert header["kappa_nm"] == 20.0
        for k, wavelength in enumerate(GRID):
            name = f"S0.{int(wavelength)},000000nm"
            assert np.array_equal(file.channels()[name].pixels, spectral.to_numpy()[..., k])
    assert [p.name for p in tmp_path.iterdir()] == ["image.exr"]


def test_mitsuba_reads_the_exr_the_same(tmp_path, spectral):
    from livlab.machine.llvm import choose_libllvm

    choose_libllvm()
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    rgb = cie_rgb(spectral)
    path = write_exr(tmp_path / "image.exr", rgb, depth="half")
    read = np.array(mi.Bitmap(str(path)))
    assert read.shape == (5, 7, 3)
    assert np.array_equal(read, rgb.to_numpy().astype(np.float16))


@pytest.mark.parametrize("bits", [8, 16])
def test_png_holds_the_encoded_colour_to_half_a_step(tmp_path, spectral, bits):
    import cv2

    rgb = cie_rgb(spectral) * 2.5 - 0.6
    shown = write_png(tmp_path / "image.png", rgb, exposure=0.7, bits=bits)
    read = cv2.imread(str(tmp_path / "image.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    top = 2**bits - 1
    assert read.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert np.abs(read - top * encode_srgb(shown).to_numpy()).max() <= 0.5 + 1e-9
    assert shown.attrs["gamut_below"] > 0
    assert [p.name for p in tmp_path.iterdir()] == ["image.png"]


def test_png_says_srgb_and_has_alpha_on_demand(tmp_path, spectral):
    from PIL import Image

    alpha = xr.DataArray(np.linspace(0, 1, 35).reshape(5, 7), dims=("row", "column"))
    write_png(tmp_path / "image.png", cie_rgb(spectral), alpha=alpha)
    with Image.open(tmp_path / "image.png") as image:
        assert image.mode == "RGBA"
        assert image.info["srgb"] == 0
        assert np.array_equal(np.asarray(image)[..., 3], np.rint(255 * alpha.to_numpy()))


def test_encoding_and_back_is_the_identity():
    linear = np.linspace(-1, 4, 5001)
    assert np.abs(decode_srgb(encode_srgb(linear)) - linear).max() < 3e-8  # the standard's two pieces meet to 3e-8


def test_a_nan_is_black_and_an_eight_bit_picture_survives(tmp_path):
    from PIL import Image

    coded = np.random.default_rng(0).integers(0, 256, (8, 9, 3))
    rgb = xr.DataArray(decode_srgb(coded / 255.0), dims=("row", "column", "channel"))
    write_png(tmp_path / "a.png", rgb)
    with Image.open(tmp_path / "a.png") as image:
        assert np.array_equal(np.asarray(image), coded)
    rgb[0, 0] = np.nan
    write_png(tmp_path / "a.png", rgb)
    with Image.open(tmp_path / "a.png") as image:
        assert np.array_equal(np.asarray(image)[0, 0], [0, 0, 0])


def test_a_write_that_fails_leaves_the_old_picture(tmp_path, spectral, monkeypatch):
    import os

    rgb = cie_rgb(spectral)
    paths = [write_exr(tmp_path / "a.exr", rgb), tmp_path / "a.png"]
    write_png(paths[1], rgb)
    before = [p.read_bytes() for p in paths]

    def full(_descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(EnvironmentProblem, match="No space"):
        write_exr(paths[0], 0 * rgb)
    with pytest.raises(EnvironmentProblem, match="No space"):
        write_png(paths[1], 0 * rgb)
    assert [p.read_bytes() for p in paths] == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.exr", "a.png"]


def test_a_missing_folder_is_told(tmp_path, spectral):
    with pytest.raises(EnvironmentProblem, match="Cannot write"):
        write_exr(tmp_path / "no" / "a.exr", cie_rgb(spectral))
    with pytest.raises(EnvironmentProblem, match="Cannot write"):
        write_png(tmp_path / "no" / "a.png", cie_rgb(spectral))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"path": "a.jpg"}, "path"),
        ({"rgb": xr.DataArray(np.zeros((2, 2, 4)), dims=("row", "column", "channel"))}, "rgb"),
        ({"rgb": xr.DataArray(np.zeros((0, 2, 3)), dims=("row", "column", "channel"))}, "rgb"),
        ({"metadata": {"comments": "mine"}}, "metadata"),
        ({"depth": "double"}, "depth"),
    ],
)
def test_bad_images_are_refused(tmp_path, spectral, change, field):
    call = {"path": "a.exr", "rgb": cie_rgb(spectral), **change}
    with pytest.raises(InputError, match=field):
        write_exr(tmp_path / call.pop("path"), call.pop("rgb"), **call)
    assert not list(tmp_path.iterdir())
