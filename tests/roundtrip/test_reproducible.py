"""The same experiment, seed and variant give the same bytes in another process, wherever and under whatever it runs.

Each run is a process of its own: hashes salted otherwise, another folder, a decimal comma, another clock zone, a home
that cannot be written or none. Everything a clock said is taken out before the bytes are compared.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from livlab.runs.compare import ACCOUNTS, timeless
from livlab.runs.files import read_csv

CONFIG = """\
schema = 1
kind = "spectral"
name = "same"
readings = ["thesis", "measured"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [500, 600, 700] }
instrument = { kind = "collinear", acceptance_deg = 90.0 }
solver = { SOLVER }
processing = { interpolate_nm = 50.0, moving_average = 2 }
[[reference]]
label = "human liver"
dataset = "liver_hsi_sellner2026"
column = "human_reflectance_share"
sd_column = "human_reflectance_share_sd"
subjects = 144
[[criterion]]
metric = "rmse"
against = "human liver"
reference = 0.0
tolerance = 0.5
"""
SOLVERS = {
    "walk": 'kind = "walk", samples = 20000, pilot = 5000, largest_launch = 15000',
    "adding-doubling": 'kind = "adding-doubling", tolerance = 1e-3',
}
# A library that honours the locale would print and read 1,5: the process sets it, as a GUI toolkit around livlab would.
MAIN = """\
import locale, sys
if len(sys.argv) > 3:
    locale.setlocale(locale.LC_ALL, sys.argv[3])
    assert locale.localeconv()["decimal_point"] == ","
from livlab.config import load_experiment
from livlab.kinds.execute import execute
print(execute(load_experiment(sys.argv[1]), base=sys.argv[2], report=len(sys.argv) > 3).folder)
"""


@pytest.fixture(scope="module")
def comma(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A locale with a decimal comma: one that is there, or one made for the test; the name is in LC_ALL."""
    listed = subprocess.run(["locale", "-a"], capture_output=True, text=True, check=False).stdout.split()
    for name in ("de_DE.utf8", "de_DE.UTF-8", "fr_FR.utf8", "pt_BR.utf8", "pt_PT.utf8", "es_ES.utf8", "it_IT.utf8"):
        if name in listed:
            return {"LC_ALL": name}
    if shutil.which("localedef"):
        room = tmp_path_factory.mktemp("locales")
        made = subprocess.run(
            ["localedef", "-i", "de_DE", "-f", "UTF-8", str(room / "de_DE.UTF-8")], capture_output=True, check=False
        )
        if made.returncode == 0:
            return {"LC_ALL": "de_DE.UTF-8", "LOCPATH": str(room)}
    pytest.skip("no locale with a decimal comma, and none can be made")


def run(place: Path, solver: str, environment: dict[str, str | None], *words: str) -> Path:
    """The run folder of a process of its own."""
    place.mkdir(parents=True)
    config = place / "same.toml"
    config.write_text(CONFIG.replace("SOLVER", SOLVERS[solver]), encoding="utf-8")
    surroundings = {k: v for k, v in (os.environ | environment).items() if v is not None}
    done = subprocess.run(
        [sys.executable, "-c", MAIN, str(config), str(place / "runs"), *words],
        env=surroundings, cwd=place, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return place / done.stdout.strip().splitlines()[-1]


def content(folder: Path) -> dict[str, bytes]:
    """The files of the result, without what a clock said."""
    names = [name for name in json.loads((folder / "manifest.json").read_text())["files"] if name not in ACCOUNTS]
    assert {"result.nc", "spectra.csv", "claims.csv", "curves.csv", "metrics.csv", "config.toml"} <= set(names)
    return {name: timeless(name, (folder / name).read_bytes()) for name in names}


@pytest.fixture(scope="module", params=list(SOLVERS))
def plain(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, libllvm: object
) -> tuple[str, Path]:
    """A solver, and its run in surroundings as they are."""
    place = tmp_path_factory.mktemp("plain") / "here"
    return request.param, run(place, request.param, {"PYTHONHASHSEED": "0", "TZ": "UTC"})


def same(plain: tuple[str, Path], other: Path) -> None:
    first, second = content(plain[1]), content(other)
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []
    assert plain[1].name == other.name


def test_hash_seed_folder_zone_and_decimal_comma_change_nothing(
    plain: tuple[str, Path], comma: dict[str, str], tmp_path: Path
) -> None:
    other = {"PYTHONHASHSEED": "4711", "TZ": "Asia/Kathmandu", **comma}
    made = run(tmp_path / "outro lugar, às 3", plain[0], other, comma["LC_ALL"])
    same(plain, made)
    page = (made / "report.html").read_text(encoding="utf-8")
    for claim in read_csv(made / "claims.csv"):  # the report, too, was written under the decimal comma
        assert claim["value"][:5] in page
        assert claim["value"][:5].replace(".", ",") not in page


def test_no_home_changes_nothing(plain: tuple[str, Path], tmp_path: Path) -> None:
    gone = dict.fromkeys(
        ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "MPLCONFIGDIR", "USER", "LOGNAME")
    )
    same(plain, run(tmp_path / "a", plain[0], {**gone, "PYTHONHASHSEED": "1"}))


def test_a_home_that_cannot_be_written_changes_nothing(plain: tuple[str, Path], tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.write_text("no folder: whoever runs this, nothing can be written below it\n")
    unset = dict.fromkeys(("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "MPLCONFIGDIR"))
    same(plain, run(tmp_path / "a", plain[0], {**unset, "HOME": str(home), "PYTHONHASHSEED": "2"}))
    assert home.is_file()


def test_another_seed_does_change_the_bytes(plain: tuple[str, Path], tmp_path: Path) -> None:
    """The comparison has power: a walk of other draws is not the same."""
    from livlab.config import load_experiment
    from livlab.kinds.execute import execute

    config = load_experiment(plain[1] / "config.toml").model_copy(update={"seed": 2})
    other = execute(config, base=tmp_path, report=False).folder
    assert other.name != plain[1].name
    changed = [name for name, raw in content(other).items() if raw != content(plain[1])[name]]
    assert ("spectra.csv" in changed) == (plain[0] == "walk")
    assert "config.toml" in changed
