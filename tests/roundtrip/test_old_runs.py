"""Runs by an older livlab, whose files called a number otherwise: they open, and compare, under today's names."""

from __future__ import annotations

import csv
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
from livlab.criteria import Claim
from livlab.criteria.table import under_former_rule
from livlab.kinds.again import read_original, run_again
from livlab.kinds.execute import execute
from livlab.kinds.report import build_report
from livlab.runs.compare import timeless
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
    (folder / "claims.csv").write_bytes(b"criterion,value,standard_error,reference,tolerance,verdict,seconds\r\n")
    claims = hashlib.sha256((folder / "claims.csv").read_bytes()).hexdigest()
    then = {"result.nc": sha256, "claims.csv": claims}
    change(
        folder,
        result_version=3,
        digest=digest(parse_experiment(TEXT), manifest["datasets"], 3),
        files=manifest["files"] | then,
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


SPHERES = """
schema = 1
kind = "optics"
name = "spheres"
radii_um = [0.05, 0.5]

[wavelengths]
list_nm = [500.0, 550.0, 600.0, 650.0]

[[particle]]
label = "glass"
n_particle = 1.5

[[criterion]]
metric = "pearson"
of = "glass"
radius_um = 0.05
reference = 1.0
tolerance = 0.001

[[criterion]]
metric = "rmse"
of = "glass"
radius_um = 0.5
reference = 0.0
tolerance = 0.01
"""
COLUMNS_THEN = "criterion,value,standard_error,reference,tolerance,verdict,seconds"


@pytest.fixture
def judged(tmp_path: Path) -> Path:
    """A run whose claims have the seven columns, and the verdicts, that result version 3 gave them."""
    folder = execute(parse_experiment(SPHERES), base=tmp_path / "then").folder
    with (folder / "claims.csv").open(newline="") as table:
        rows = [row[:7] for row in csv.reader(table)][1:]
    assert [row[5] for row in rows] == ["PASS", "FAIL"]
    lines = [COLUMNS_THEN, *(",".join(f'"{c}"' if "," in c else c for c in row) for row in rows)]
    (folder / "claims.csv").write_bytes("".join(f"{line}\r\n" for line in lines).encode())
    _seal(folder)
    return folder


def _seal(folder: Path) -> None:
    raw = (folder / "claims.csv").read_bytes()
    manifest = read_manifest(folder)
    change(
        folder,
        result_version=3,
        digest=digest(parse_experiment(SPHERES), manifest["datasets"], 3),
        files=manifest["files"] | {"claims.csv": hashlib.sha256(raw).hexdigest()},
        results=manifest["results"] | {"claims.csv": hashlib.sha256(timeless("claims.csv", raw)).hexdigest()},
    )


def test_claims_of_an_old_run_keep_the_verdicts_of_then(judged: Path) -> None:
    claims = livlab.open_run(judged).claims
    assert repr(claims) == "<2 claims: 1 PASS, 1 FAIL>"
    assert {c.rule for c in claims} == {"tolerance"}
    assert [c.wanted for c in claims] == ["at least 0.999", "at most 0.01"]
    page = build_report(judged).read_text(encoding="utf-8")
    assert "Judged by an older livlab, and shown as judged then" in page
    assert "at least 0.999" in page


def test_an_old_run_done_again_is_compared_by_the_rule_of_then(judged: Path, tmp_path: Path) -> None:
    again = run_again(read_original(judged), report=False)
    told = next(f for f in again.files if f.name == "claims.csv")
    assert told.verdict in ("same", "same but for times")
    assert told.detail.startswith("the verdict rule is another since result version 4: compared by the former")
    assert again.same
    (tmp_path / "posted").mkdir()
    shutil.copy(judged / "manifest.json", tmp_path / "posted" / "manifest.json")
    assert run_again(read_original(tmp_path / "posted"), report=False).same


def test_an_old_value_that_differs_is_told_beside_the_rule(judged: Path) -> None:
    text = (judged / "claims.csv").read_text()
    value = re.search(r"glass\"?,(0\.99\d+),", text).group(1)  # type: ignore[union-attr]
    (judged / "claims.csv").write_bytes(text.replace(value, "0.9995").encode())
    _seal(judged)
    told = next(f for f in run_again(read_original(judged), report=False).files if f.name == "claims.csv")
    assert told.verdict == "differs"
    assert "verdict rule is another" in told.detail
    assert "value most" in told.detail


def test_underpowered_verdicts_of_then_open_and_have_their_notes() -> None:
    """What the former rule wrote of claims of today, literally; and a verdict of then is held against its numbers."""
    claims = [
        Claim.of("rmse a", 0.05, 0.03, 0.0, 0.1),
        Claim.of("hue b", 30.0, 1.0, at_least=15.0, at_most=60.0),
        Claim.of("chroma c", 3.0, 0.5, at_most=8.0),
        Claim.of("speed d", 3.0, 0.0, at_least=8.0),
        Claim.missing("pearson e", "no table", reference=1.0, tolerance=0.1),
    ]
    then = under_former_rule(claims)
    assert then["claims.csv"].decode().splitlines() == [
        COLUMNS_THEN,
        "rmse a,0.05,0.03,0.0,0.1,PASS,0",
        "hue b,30.0,1.0,37.5,22.5,PASS,0",
        "chroma c,3.0,0.5,4.0,4.0,PASS,0",
        "pearson e,,,1.0,0.1,MISSING,0",
    ]
    noisy = under_former_rule([Claim.of("rmse a", 0.05, 0.06, 0.0, 0.1)])
    assert b"rmse a,0.05,0.06,0.0,0.1,FAIL,0" in noisy["claims.csv"]
    assert json.loads(noisy["claims.notes.json"]) == {
        "rmse a": "underpowered: standard error 0.06 exceeds half the tolerance 0.1"
    }
