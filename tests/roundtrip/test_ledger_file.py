"""Ledgers on disk: read back the same; anything else is refused with a reason."""

import math

import numpy as np
import pytest
import xarray as xr

from livlab.errors import DatasetError, EnvironmentProblem
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.ledger.record_ledger import Detector, load, record
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally

W = np.array([500.0, 600.0, 700.0])
ONE = np.ones(3)


@pytest.fixture(scope="module")
def ledger(libllvm):
    phases = (HenyeyGreenstein(0.8),) * 3
    made = []
    for name, thickness, n, mus in (("capsule", 0.1, 1.36, 9.0), ("bulk", math.inf, 1.38, 11.0)):
        parts = (
            Interaction("blood", np.array([1.0, 0.5, 0.2]), 0 * ONE, phases),
            Interaction("cells", mus * ONE, ONE, phases),
        )
        made.append(PlaneLayer(name, thickness, n * ONE, parts))
    tally = Tally((0.0, 0.7, math.pi / 2), (0.0, 1.0, math.inf))
    light = Source.collimated(0.3, disc_radius_mm=0.2)
    return record(OpticalStack(W, tuple(made), ONE, ONE, "två lager"), samples=5000, tally=tally, source=light, seed=2)


@pytest.fixture
def path(ledger, tmp_path):
    ledger.save(tmp_path / "made.nc")
    return tmp_path / "made.nc"


@pytest.mark.parametrize("small", [False, True])
def test_read_back_the_same(ledger, tmp_path, small):
    kept = ledger.compressed(1e-3) if small else ledger
    kept.save(tmp_path / "l.nc")
    back = load(tmp_path / "l.nc")
    assert back.entries.digest() == kept.entries.digest()
    assert back.tally == kept.tally
    assert back.source == kept.source
    assert back.about == kept.about
    for name in ("degree", "scaled", "counted", "positions", "depth_bias"):
        assert getattr(back, name) == getattr(kept, name)
    xr.testing.assert_identical(back.spectrum(degenerate="mark"), kept.spectrum(degenerate="mark"))
    one = (kept.served.absorption, kept.served.scattering)
    xr.testing.assert_identical(
        back.evaluate(*one, wavelength_nm=W, gradient=True), kept.evaluate(*one, wavelength_nm=W, gradient=True)
    )
    ring = Detector.annulus(0.0, 1.0)
    assert np.array_equal(back.answer(back.served, ring).value, kept.answer(kept.served, ring).value)
    assert (back.compression is None) == (not small)
    if small:
        assert back.compression.error == kept.compression.error
        assert np.array_equal(back.compression.low, kept.compression.low)


def test_the_file_says_what_it_is(path):
    with xr.open_dataset(path, engine="h5netcdf") as file:
        assert file.attrs["format"] == "livlab ledger"
        assert "mm" in file.attrs["conventions"]
        assert file.served_wavelength_nm.attrs["units"] == "nm"
        assert file.served_absorption.attrs["units"] == "1/mm"
        assert not [v for v in file.variables.values() if v.dtype == object]


def test_the_same_ledger_gives_the_same_answers_in_a_smaller_file(ledger, path, tmp_path):
    ledger.compressed(1e-3).save(tmp_path / "small.nc")
    assert (tmp_path / "small.nc").stat().st_size < 0.5 * path.stat().st_size


def test_missing_file(tmp_path):
    with pytest.raises(DatasetError, match="no such file"):
        load(tmp_path / "none.nc")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_torn_files(path, share):
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(DatasetError, match=r"cannot be read|damaged"):
        load(path)


def test_text_and_foreign_files(tmp_path):
    text = tmp_path / "text.nc"
    text.write_text("reflectance, 0.3\n", encoding="utf-8")
    with pytest.raises(DatasetError, match="cannot be read"):
        load(text)
    foreign = tmp_path / "foreign.nc"
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(foreign, engine="h5netcdf")
    with pytest.raises(DatasetError, match="is no livlab ledger"):
        load(foreign)


def changed(path, change):
    with xr.open_dataset(path, engine="h5netcdf") as file:
        held = file.load()
    held = change(held)
    held.to_netcdf(path, engine="h5netcdf")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda d: d.assign_attrs(version=2), "has version 2"),
        (lambda d: d.drop_vars("features"), "damaged"),
        (lambda d: d.assign(log_weight=d.log_weight + np.float32(1.0)), "checksum"),
        (lambda d: d.assign(bear=("wavelength", ONE)), "dimensions"),
        (lambda d: d.isel(entry=slice(5)), "checksum"),
        (lambda d: d.assign_attrs(ledger="{}"), "damaged"),
        (lambda d: d.assign_attrs(ledger="{"), "damaged"),
        (lambda d: d.assign(anchor=d.anchor + np.uint16(40)), "walk that is not there"),
        (lambda d: d.assign(served_absorption=-d.served_absorption), "damaged"),
    ],
)
def test_changed_files(path, change, named):
    changed(path, change)
    with pytest.raises(DatasetError, match=named):
        load(path)


def test_folder_that_is_not_there(ledger, tmp_path):
    with pytest.raises(EnvironmentProblem, match="Cannot write"):
        ledger.save(tmp_path / "nowhere" / "l.nc")


def test_an_old_file_stays_if_writing_fails(ledger, path, monkeypatch):
    before = path.read_bytes()

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", full)
    with pytest.raises(EnvironmentProblem, match="No space"):
        ledger.save(path)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]
