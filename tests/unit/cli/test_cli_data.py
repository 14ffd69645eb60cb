"""`livlab data`: what is printed, what is asked, what is refused."""

import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from livlab import datasets
from livlab.cli.data import app
from livlab.datasets import load
from livlab.errors import DatasetError, EnvironmentProblem, InputError, Interrupted, LivlabError


@pytest.fixture(autouse=True)
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path / "mine"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "mine"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "Liver 7.csv"
    path.write_text("wavelength;reflectance\n500;0,1\n600;0,3\n")
    return path


def run(*arguments: object, answers: str | None = None) -> Any:
    return CliRunner().invoke(app, [str(a) for a in arguments], input=answers)


def ok(*arguments: object, answers: str | None = None) -> str:
    result = run(*arguments, answers=answers)
    assert result.exit_code == 0, (result.output, result.exception)
    return result.output


def fails(error: type[LivlabError], *arguments: object, answers: str | None = None) -> str:
    result = run(*arguments, answers=answers)
    assert isinstance(result.exception, error), (result.output, result.exception)
    return str(result.exception)


GIVEN = ("--name", "l7", "--source", "me", "--kind", "tabulated", "--unit", "1", "--yes")


def test_list_shows_what_there_is_and_what_not(file: Path, mine: Path) -> None:
    ok("add", file, *GIVEN)
    text = ok("list")
    for name in datasets.names():
        assert re.search(rf"^{name} ", text, re.MULTILINE)
    assert re.search(r"haemoglobin_prahl +tabulated +250 to 1000 +376 +livlab", text)
    assert re.search(rf"l7 +tabulated +500 to 600 +2 +{re.escape(str(mine))}", text)
    available, missing = text.split("not available")
    assert "nunes2017_brdf" in missing
    assert "nunes2017_brdf" not in available
    ok("add", file, "--name", "nunes2017_brdf", "--kind", "fit", "--unit", "1", "--yes")
    assert "  nunes2017_brdf  " not in ok("list")
    (mine / "l7" / "table.csv").write_text("x")
    assert re.search(r"l7 +damaged", ok("list"))


def test_show() -> None:
    text = ok("show", "bile_nachabe2011", "--rows", 2)
    for part in (
        "10.1364/BOE.2.000600",
        "digitised",
        "314 to 1600.9 nm",
        "1/cm",
        "39.1941",
        "(verified)",
        "(relative 0.04)",
    ):
        assert part in text
    assert "32.2459" not in text
    assert "tabulated" in ok("show", "nunes2019_table71")
    assert "livlab data add FILE --name nachabe2011_liver" in fails(DatasetError, "show", "nachabe2011_liver")
    fails(InputError, "show", "../secret")


def test_check(file: Path, mine: Path) -> None:
    assert "none damaged" in ok("check")
    assert "1 checked" in ok("check", "lipid_vanveen2004")
    ok("add", file, *GIVEN)
    table = mine / "l7" / "table.csv"
    table.write_text(table.read_text().replace("0.3", "0.4"))
    result = run("check")
    assert isinstance(result.exception, DatasetError)
    assert "1 of 15 datasets are damaged: l7" in str(result.exception)
    assert "--replace" in result.output
    # The remedy that it names works, and keeps what was known.
    ok("add", table, "--name", "l7", "--into", mine, "--replace", "--yes")
    assert "none damaged" in ok("check")
    assert load("l7").meta.source == "me"
    assert load("l7").interpolate("reflectance", 600.0) == 0.4


@pytest.mark.parametrize(("ending", "magic"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF")])
def test_plot(tmp_path: Path, ending: str, magic: bytes) -> None:
    file = tmp_path / f"p.{ending}"
    assert str(file) in ok("plot", "liver_hsi_sellner2026", "-o", file)
    assert file.read_bytes().startswith(magic)
    assert [p.name for p in tmp_path.iterdir()] == [file.name]


def test_plot_draws_the_numbers() -> None:
    from livlab.datasets.plot import plot

    axes = plot(load("liver_hsi_sellner2026")).axes[0]
    assert [line.get_label() for line in axes.lines] == ["human reflectance share", "rat reflectance share"]
    assert list(axes.lines[0].get_ydata()) == list(load("liver_hsi_sellner2026").column("human_reflectance_share"))
    assert len(axes.collections) == 2
    assert axes.get_yscale() == "linear"
    assert plot(load("haemoglobin_prahl")).axes[0].get_yscale() == "log"


def test_plot_refuses(tmp_path: Path) -> None:
    assert "must end in" in fails(InputError, "plot", "bile_nachabe2011", "-o", tmp_path / "p.gif")
    assert "cannot be written" in fails(EnvironmentProblem, "plot", "bile_nachabe2011", "-o", tmp_path / "no" / "p.svg")
    assert "no wavelengths" in fails(DatasetError, "plot", "nunes2019_table61")
    assert ok("plot", "bile_nachabe2011").strip() == "bile_nachabe2011.svg"


def test_add_by_options_says_what_it_understood(file: Path) -> None:
    text = ok("add", file, *GIVEN, "--doi", "10.1000/182", "--uncertainty", "5 %", "--relative-uncertainty", "0.05")
    assert "understood: semicolon-separated, decimal comma" in text
    assert "column: reflectance [1] 0.1 to 0.3, 2 rows" in text
    meta = load("l7").meta
    assert (meta.doi, meta.uncertainty.text, meta.uncertainty.relative, meta.title) == (
        "10.1000/182",
        "5 %",
        0.05,
        "l7",
    )


def test_add_asks_and_asks_again(file: Path) -> None:
    answers = ["../x", "liver_7", "smoots", "%", "", "", "own, 2026", "guess", "digitised", "", "", "2 %", "y"]
    text = ok("add", file, answers="\n".join(answers) + "\n")
    assert "name [liver_7]" in text
    assert "must be 1 to 64" in text
    assert "is not a unit livlab knows" in text
    assert "must be one of tabulated" in text
    liver = load("liver_7")
    assert (liver.meta.kind, liver.meta.source, liver.unit("reflectance")) == ("digitised", "own, 2026", "%")
    assert liver.meta.uncertainty.text == "2 %"


@pytest.mark.parametrize("answers", ["", "a\n", "a\n1\nt\ns\ntabulated\n\n\n\nn\n"])
def test_add_stopped_midway_writes_nothing(file: Path, mine: Path, answers: str) -> None:
    assert "Nothing was added" in fails(Interrupted, "add", file, answers=answers)
    assert not mine.exists()


def test_add_takes_what_is_known_of_a_missing_reference(file: Path) -> None:
    ok("add", file, "--name", "nachabe2011_liver", "--kind", "digitised", "--column", "reflectance:1", "--yes")
    meta = load("nachabe2011_liver").meta
    assert meta.doi == "10.1364/BOE.2.000600"
    assert meta.source.startswith("R. Nachabe")


@pytest.mark.parametrize(("drop", "says"), [("--source", "source"), ("--kind", "kind"), ("--unit", "unit")])
def test_yes_invents_nothing(file: Path, mine: Path, drop: str, says: str) -> None:
    options = list(GIVEN)
    del options[options.index(drop) : options.index(drop) + 2]
    message = fails(InputError, "add", file, *options)
    assert message.startswith(says)
    assert "is not known" in message
    assert f"Give it: {drop} " in message
    assert f"--{says}" in message
    assert not mine.exists()


def test_add_refuses_bad_files(tmp_path: Path, mine: Path) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text("wavelength,reflectance\n600,0.1\n500,0.2\n550,0.2\n")
    assert "line 3" in fails(InputError, "add", bad, *GIVEN)
    with bad.open("wb") as stream:
        stream.truncate(200 * 2**20)
    assert "200.0 MiB" in fails(InputError, "add", bad, *GIVEN)
    assert "does not exist" in fails(InputError, "add", tmp_path / "absent.csv", *GIVEN)
    assert not mine.exists()
