"""livlab in odd surroundings, each in a process of its own: no home, a read-only one, other paths, marks and clocks."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from livlab.brdf.files.formats import read_brdf
from livlab.config import load_experiment
from livlab.errors import ConfigError, LivlabError
from livlab.kinds import execute as runs
from livlab.kinds.report import rebuild_report
from livlab.model.shapes import box
from livlab.runs import identity as identity_of

CONFIG = """\
schema = 1
kind = "spectral"
name = "odd"
title = "Größe, 测量 и мера"
readings = ["measured"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [500, 600] }
instrument = { kind = "hyperspectral-camera" }
solver = { kind = "adding-doubling", tolerance = 1e-2 }
"""
CALL = "import sys; from livlab.cli import main; sys.argv[0] = 'livlab'; main()"
# Whatever asks for a number's marks gets a comma and points, as under a German locale that this machine may not have.
COMMA = """\
import locale, sys
marks = {**locale.localeconv(), "decimal_point": ",", "thousands_sep": ".", "grouping": [3, 3, 0]}
locale.localeconv = lambda: dict(marks)
locale._override_localeconv.update(marks)
"""
BACKWARDS = """\
import datetime, itertools, types
import livlab.kinds.execute
start, ticks = datetime.datetime.now(datetime.UTC), itertools.count()
livlab.kinds.execute.datetime = types.SimpleNamespace(now=lambda zone: start - datetime.timedelta(hours=next(ticks)))
"""
AWAY = "A folder, with ümläuts & 空白 'quoted'"


def livlab(place: Path, *words: str, before: str = "", **changes: str | None) -> subprocess.CompletedProcess[str]:
    kept = {k: v for k, v in {**os.environ, **changes}.items() if v is not None}
    return subprocess.run(
        [sys.executable, "-c", before + CALL, *words], cwd=place, env=kept, capture_output=True, text=True,
        timeout=300, check=False, encoding="utf-8",
    )  # fmt: skip


def ran(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "odd.toml").write_text(CONFIG, encoding="utf-8")
    return tmp_path


def numbers(place: Path) -> bytes:
    (folder,) = (place / "runs").glob("odd-*")
    return (folder / "tissue.csv").read_bytes()


def test_no_home_or_one_that_cannot_be_written(place: Path) -> None:
    (place / "file").write_text("")
    ran(
        livlab(
            place,
            "run",
            "odd.toml",
            "--no-report",
            HOME=None,
            XDG_CACHE_HOME=None,
            XDG_DATA_HOME=None,
            LIVLAB_DATA=None,
        )
    )
    first = numbers(place)
    # A file in place of a folder: nobody, not even root, can write below it.
    ran(livlab(place, "run", "odd.toml", "--force", "--no-report", HOME=str(place / "file"), LIVLAB_DATA=None))
    assert numbers(place) == first


@pytest.mark.parametrize("report", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_paths_with_blanks_quotes_and_other_scripts(place: Path, report: bool) -> None:
    away = place / AWAY
    away.mkdir()
    (place / "odd.toml").rename(away / "odd one.toml")
    options = [] if report else ["--no-report"]
    said = ran(livlab(place, "run", "-q", f"{AWAY}/odd one.toml", "--out", f"{AWAY}/my runs", *options))
    if report:
        page = place / said.strip()
        assert "Größe, 测量 и мера" in page.read_text(encoding="utf-8")
        ran(livlab(away, "report", str(page.parent)))
        box(10.0).as_trimesh().export(away / "ein Körper.ply")
        ran(livlab(away, "mesh", "ein Körper.ply", "--how", "scale", "--out", "noch einer.stl"))
        assert len(list(away.glob("noch einer-*.stl"))) == 2
        told = livlab(away, "gallery", "--runs", "my runs", "--out", "Bilder einer Ausstellung")
        assert "no finished picture" in told.stderr
        assert "remedy" in told.stderr
    assert len(list((away / "my runs").glob("odd-*/manifest.json"))) == 1
    samples = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value_L\n0,0,10,0,0.5\n20,0,30,90,0.4\n"
    (away / "f ø.csv").write_text(samples, encoding="utf-8")
    ran(livlab(away, "brdf", "convert", "f ø.csv", "f 空.nc"))
    assert read_brdf(away / "f 空.nc").sizes["sample"] == 2


def test_a_decimal_comma_changes_no_file(place: Path) -> None:
    ran(livlab(place, "run", "odd.toml", "--no-report"))
    first = numbers(place)
    options = ["--force", "--no-report"]
    ran(livlab(place, "run", "odd.toml", *options, before=COMMA, LC_ALL="de_DE.UTF-8", LANG="de_DE.UTF-8"))
    assert numbers(place) == first
    assert b"," in first


def test_a_clock_that_runs_backwards(place: Path) -> None:
    ran(livlab(place, "run", "odd.toml", "--no-report", before=BACKWARDS))
    (folder,) = (place / "runs").glob("odd-*")
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["finished"] < manifest["started"]  # the clock did go back
    assert 0 <= manifest["seconds"] < 300
    assert "Done before" in ran(livlab(place, "run", "odd.toml", "--no-report", before=BACKWARDS))


@pytest.mark.parametrize(
    "content",
    [b"\xff\xfe\0", b"schema = 1\nname = '\0'", b"seed = " + b"9" * 9000, b"[" * 9000, b"schema = 1\n[x", b""],
)
def test_no_traceback_whatever_the_file(place: Path, content: bytes) -> None:
    (place / "odd.toml").write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_experiment(place / "odd.toml")
    assert caught.value.remedy


@pytest.mark.parametrize("status", ["complete", "partial"])
@pytest.mark.parametrize(
    "manifest",
    [
        {"files": {"/dev/zero": "0", "../x": "1"}},
        {"seconds": "many", "started": [1]},
        {"seconds": float("nan")},
        {"files": [1], "notes": 3, "packages": "no", "claim_notes": [2]},
    ],
)
def test_a_manifest_that_lies(place: Path, manifest: dict[str, object], status: str) -> None:
    config = load_experiment(place / "odd.toml").resolve()
    identity = identity_of.digest(config, identity_of.dataset_hashes(config.datasets()))
    folder = identity_of.folder_of(config, identity, place / "runs")
    folder.mkdir(parents=True)
    text = json.dumps({"digest": identity, "status": status, "kind": "spectral", **manifest})
    (folder / "manifest.json").write_text(text, encoding="utf-8")
    assert not identity_of.is_complete(folder, identity)
    (folder / "config.toml").write_text(CONFIG, encoding="utf-8")
    try:
        rebuild_report(folder)
    except LivlabError as error:
        assert error.remedy
    assert runs.execute(config, base=place / "runs", report=False).folder == folder
    assert identity_of.is_complete(folder, identity)
    again = identity_of.read_manifest(folder)
    assert 0 <= again["seconds"] < 300
