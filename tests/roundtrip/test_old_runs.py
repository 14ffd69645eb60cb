"""Runs by an older livlab, whose files called a number otherwise: they open, and compare, under today's names."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import livlab
from livlab.config import parse_experiment
from livlab.kinds.again import read_original, run_again
from livlab.kinds.execute import execute
from livlab.kinds.report import build_report
from livlab.runs.identity import digest, read_manifest

TEXT = """
schema = 1
kind = "brdf"
name = "old"
readings = ["measured"]
tissue = { preset = "liver", variant = "parenchyma_only" }
wavelengths = { list_nm = [700.0] }
lobes_deg = [30.0]
[rig]
radius_px = 16.0
samples_per_pixel = 4
lights = { layout = "arc", count = 2, first_deg = 10.0, last_deg = 60.0, distance_radii = "infinite" }
[scan]
step_deg = 15.0
last_deg = 75.0
[goniometer]
theta_step_deg = 15.0
phi_step_deg = 45.0
samples = 2000
"""
NAMES = {"diffuse_reflectance": "reflectance", "diffuse_reflectance_se": "reflectance_se"}


def change(folder: Path, **entries: Any) -> None:
    (folder / "manifest.json").write_text(json.dumps(read_manifest(folder) | entries))


def figures(page: str) -> list[str]:
    return re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return execute(parse_experiment(TEXT), base=tmp_path_factory.mktemp("runs")).folder


@pytest.fixture
def old(made: Path, tmp_path: Path) -> Path:
    """The run as result version 3 wrote it."""
    folder = Path(shutil.copytree(made, tmp_path / "then" / "old-3"))
    with xr.open_dataset(folder / "result.nc", engine="h5netcdf") as data:
        then = data.load().rename(NAMES)
    tree = xr.DataTree.from_dict({"/": then})
    (folder / "result.nc").write_bytes(bytes(tree.to_netcdf(None, engine="h5netcdf")))
    sha256 = hashlib.sha256((folder / "result.nc").read_bytes()).hexdigest()
    manifest = read_manifest(folder)
    change(
        folder,
        result_version=3,
        digest=digest(parse_experiment(TEXT), manifest["datasets"], 3),
        files=manifest["files"] | {"result.nc": sha256},
        results=manifest["results"] | {"result.nc": sha256},
    )
    return folder


def test_files_of_today_have_no_reflectance_that_is_not_the_instruments(made: Path) -> None:
    with xr.open_dataset(made / "result.nc", engine="h5netcdf") as data:
        assert set(NAMES) <= set(data)
        assert not set(NAMES.values()) & set(data)


def test_an_old_run_opens_under_the_names_of_today(made: Path, old: Path) -> None:
    xr.testing.assert_identical(livlab.open_run(old).result, livlab.open_run(made).result)
    before = (old / "report.html").read_text(encoding="utf-8")
    assert "The spheres" in before
    after = build_report(old).read_text(encoding="utf-8")
    assert figures(after) == figures(before)


def test_an_old_run_done_again_is_the_same_and_says_what_is_called_otherwise(old: Path) -> None:
    again = run_again(read_original(old), report=False)
    assert again.same
    assert [str(d) for d in again.differences] == ["result version: 3 then, 4 now"]
    result = next(f for f in again.files if f.name == "result.nc")
    assert result.verdict == "same"
    assert result.detail == "reflectance is now diffuse_reflectance, reflectance_se is now diffuse_reflectance_se"


def test_the_manifest_of_an_old_run_is_enough(old: Path, tmp_path: Path) -> None:
    alone = tmp_path / "posted" / "manifest.json"
    alone.parent.mkdir()
    shutil.copy(old / "manifest.json", alone)
    assert run_again(read_original(alone), report=False).same


def test_an_old_number_that_differs_is_told(old: Path) -> None:
    with xr.open_dataset(old / "result.nc", engine="h5netcdf") as data:
        moved = data.load()
    moved["reflectance"] = moved["reflectance"] + 0.25
    raw = bytes(xr.DataTree.from_dict({"/": moved}).to_netcdf(None, engine="h5netcdf"))
    (old / "result.nc").write_bytes(raw)
    sha256 = hashlib.sha256(raw).hexdigest()
    manifest = read_manifest(old)
    change(old, files=manifest["files"] | {"result.nc": sha256}, results=manifest["results"] | {"result.nc": sha256})
    again = run_again(read_original(old), report=False)
    result = next(f for f in again.files if f.name == "result.nc")
    assert result.verdict == "differs"
    assert "reflectance: up to 0.25" in result.detail
