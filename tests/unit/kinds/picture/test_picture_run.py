"""A picture run around a camera that needs no renderer: its files, stopping and going on, wishes met."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from picture_fakes import BallCamera, small

from livlab.errors import Interrupted
from livlab.kinds import execute as runs
from livlab.kinds.picture import job as picture
from livlab.kinds.picture.config import PictureExperiment
from livlab.kinds.picture.cost import image_error, typical_error
from livlab.kinds.picture.film import CameraFilm
from livlab.model.colour import thesis_rgb
from livlab.model.tissue.stack import OpticalStack
from livlab.runs.identity import is_complete

WIDE = """
baselines = ["lambert", "dipole"]
"""
MORE = """
[[compared]]
name = "fatty"
tissue = { preset = "liver", state = "steatosis", set = { "layers.parenchyma.index.outside" = "hold", "layers.parenchyma.elements.lipid_and_water.parts.lipid.spectrum.outside" = "hold" } }

[[criterion]]
metric = "lightness"
reading = "thesis"
within = [0, 100]

[cost]
width = 12
spp = [4, 16]
ways = ["together", "one by one"]
"""  # noqa: E501


def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, config: PictureExperiment, camera: Any = BallCamera, **how: Any
) -> Path:
    monkeypatch.setattr(picture, "prepare", functools.partial(_PREPARE, make_camera=camera))
    return runs.execute(config, base=tmp_path, report=False, **how).folder


_PREPARE = picture.prepare


def full() -> PictureExperiment:
    return small(MORE, 'readings = ["thesis", "measured"]', 'readings = ["thesis", "measured"]' + WIDE)


def test_a_run_leaves_pictures_spectra_tables_and_claims(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = run(tmp_path, monkeypatch, full())
    with xr.open_dataset(folder / "image.nc", engine="h5netcdf") as image:
        assert image["radiance"].dims == ("reading", "row", "column", "wavelength")
        assert image.sizes == {"reading": 2, "row": 16, "column": 24, "wavelength": 6}
        assert bool((image["radiance_se"].where(image["lit"]) > 0).sum() == 2 * 6 * int(image["lit"].sum()))
        assert image["samples"].to_numpy().tolist() == [12, 12]
        wanted = thesis_rgb(image["radiance"].sel(reading="thesis").astype(float), 20.0, 2)
    pictures = pd.read_csv(folder / "pictures.csv")
    assert set(pictures["png"]) == {
        "thesis-thesis.png", "measured-thesis.png", "fatty-thesis-thesis.png", "fatty-measured-thesis.png",
        "baseline-lambert-thesis.png", "baseline-dipole-thesis.png",
    }  # fmt: skip
    for name in [
        *pictures["png"],
        *pictures["exr"],
        "image.png",
        "image.exr",
        "preview.png",
        "image-fatty.nc",
        "baselines.nc",
    ]:
        assert (folder / name).stat().st_size > 0
    import OpenEXR

    with OpenEXR.File(str(folder / "thesis-thesis.exr")) as file:
        pixels = file.channels()["RGB"].pixels
    assert np.allclose(pixels, wanted.to_numpy(), rtol=2e-3, atol=1e-4)
    colours = pd.read_csv(folder / "colours.csv")
    assert len(colours) == 4
    assert (colours["L_se"] > 0).all()
    assert pd.read_csv(folder / "claims.csv")["verdict"].tolist() == ["PASS"]
    assert is_complete(folder)
    assert not (folder / ".pieces").exists()


def test_the_cost_study_measures_errors_that_fall_with_samples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ways = pd.read_csv(run(tmp_path, monkeypatch, full()) / "ways.csv")
    together = ways[ways["way"] == "together"].set_index("spp")
    assert together.loc[4, "error"] / together.loc[16, "error"] == pytest.approx(2.0, rel=0.25)
    assert np.allclose(ways["error"], ways["stated_error"], rtol=0.25)
    assert set(ways["way"]) == {"together", "one by one"}
    typical = together["typical_error"]
    assert typical[4] / typical[16] == pytest.approx(2.0, rel=0.35)
    other = ways[ways["way"] == "one by one"]
    assert (other["mean_difference_se"] > 0).all()
    assert (other["mean_difference"].abs() < 4 * other["mean_difference_se"]).all()


def test_image_error_is_that_of_one_picture() -> None:
    rng = np.random.default_rng(4)
    a, b = (10.0 + rng.normal(0, 0.3, 200_000) for _ in range(2))
    assert image_error(a, b) == pytest.approx(0.03, rel=0.01)
    assert typical_error(a, b) == pytest.approx(0.03, rel=0.02)
    a[0] += 1e5  # one very bright pixel
    assert image_error(a, b) > 1.0
    assert typical_error(a, b) == pytest.approx(0.03, rel=0.1)


class Stopping(BallCamera):
    """Asks to stop during its third pass."""

    run: Any = None
    asked = 0

    def expose(self, film: CameraFilm, stack: OpticalStack, *, spp: int, seed: int) -> None:
        super().expose(film, stack, spp=spp, seed=seed)
        type(self).asked += 1
        if type(self).asked == 3:
            raise_stop()


def raise_stop() -> None:
    import os
    import signal

    os.kill(os.getpid(), signal.SIGINT)


def test_a_stopped_run_goes_on_and_ends_with_the_numbers_of_one_that_was_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small(old="spp = 12\npass_spp = 4", new="spp = 20\npass_spp = 4")
    whole = run(tmp_path / "whole", monkeypatch, config)
    Stopping.asked = 0
    with pytest.raises(Interrupted):
        run(tmp_path / "stopped", monkeypatch, config, Stopping)
    (folder,) = (tmp_path / "stopped").iterdir()
    assert (folder / "preview.png").is_file()
    assert not is_complete(folder)
    again = run(tmp_path / "stopped", monkeypatch, config, Stopping)
    assert again == folder
    assert Stopping.asked == 10  # two readings of five passes each: none was done twice
    with (
        xr.open_dataset(whole / "image.nc", engine="h5netcdf") as first,
        xr.open_dataset(again / "image.nc", engine="h5netcdf") as second,
    ):
        assert np.array_equal(first["radiance"], second["radiance"])
        assert np.array_equal(first["radiance_se"], second["radiance_se"])


def test_readings_draw_independently(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras: list[BallCamera] = []

    def make(config: PictureExperiment) -> BallCamera:
        cameras.append(BallCamera(config))
        return cameras[-1]

    run(tmp_path, monkeypatch, small(), make)
    seeds = {seed for _, seed in cameras[0].exposed}
    assert len(seeds) == 2


def test_a_wish_ends_a_picture_early_and_is_met(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = small("\n[accuracy]\nrelative = 0.1\n", old="spp = 12\npass_spp = 4", new="spp = 2000\npass_spp = 10")
    folder = run(tmp_path, monkeypatch, config)
    costs = pd.read_csv(folder / "costs.csv").query("stage == 'picture'")
    assert (costs["relative_error"] <= 0.1).all()
    assert (costs["spp"] < 2000).all()
    assert (costs["spp"] > 50).all()  # exponential samples need 1/0.1² of them


def test_a_tissue_beyond_its_data_is_refused_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from livlab.errors import RangeError

    config = small(old='"layers.parenchyma.index.outside" = "hold"\n', new="")
    with pytest.raises(RangeError, match="liver_refractive_index"):
        run(tmp_path, monkeypatch, config)
    assert list(tmp_path.iterdir()) == []
