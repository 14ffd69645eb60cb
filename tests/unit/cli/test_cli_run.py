"""`livlab run`, `schema` and `report`: what is printed, and what a wrong call is told."""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from livlab.cli import app
from livlab.cli.progress import PlainProgress, watched
from livlab.errors import ConfigError, LivlabError
from livlab.runs.identity import read_manifest
from livlab.runs.work import Silent

SMALL = """\
schema = 1
kind = "spectral"
name = "small"
readings = ["thesis"]
tissue = { variant = "parenchyma_only" }
wavelengths = { list_nm = [500, 600, 700] }
instrument = { kind = "hyperspectral-camera" }
solver = { kind = "adding-doubling", tolerance = 1e-3 }
[[reference]]
label = "human liver"
dataset = "liver_hsi_sellner2026"
column = "human_reflectance_share"
[[criterion]]
metric = "rmse"
against = "human liver"
reference = 0.0
tolerance = 0.5
[[criterion]]
metric = "energy residual"
reference = 0.0
tolerance = 1e-4
"""


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL)
    return tmp_path


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """A folder in which small.toml has been run, and what that printed."""
    folder = tmp_path_factory.mktemp("ran")
    with contextlib.chdir(folder):
        Path("small.toml").write_text(SMALL)
        code, out, error = call("run", "small.toml")
        assert (code, error) == (0, None)
        yield folder, out


def call(*words: str) -> tuple[int, str, BaseException | None]:
    result = CliRunner().invoke(app, list(words))
    return result.exit_code, result.output, result.exception


def test_claims_are_readable_in_a_narrow_terminal(ran: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, _ = ran
    monkeypatch.setenv("NO_COLOR", "1")
    with contextlib.chdir(folder):
        monkeypatch.setenv("COLUMNS", "200")
        wide = call("run", "small.toml")[1]
        monkeypatch.setenv("COLUMNS", "60")
        narrow = call("run", "small.toml")[1].splitlines()
    criterion = "rmse thesis vs human liver 500-700"
    (row,) = [line for line in wide.splitlines() if criterion in line]
    _, _, value, wanted, verdict, _ = (cell.strip() for cell in row.split("│"))
    k = next(k for k, line in enumerate(narrow) if criterion in line)
    assert narrow[k] == f"{verdict}  {criterion}"
    assert narrow[k + 1] == f"      {value}  (wanted {wanted})"
    assert max(map(len, narrow[:-1])) <= 60


def test_a_missing_claim_says_why(small: Path) -> None:
    (small / "small.toml").write_text(SMALL.replace("[500, 600, 700]", "[480, 600]"))
    code, out, error = call("run", "small.toml", "--no-report")
    assert (code, error) == (0, None)
    assert out.count("MISSING: reference human liver = 480.0: is outside its range, 500–1000 nm.") == 1


def test_a_run_prints_its_claims_and_ends_with_the_reports_path(ran: tuple[Path, str]) -> None:
    folder, out = ran
    lines = out.strip().splitlines()
    page = folder / lines[-1]
    assert page.name == "report.html"
    assert page.is_file()
    assert "rmse thesis vs human" in out
    assert "PASS" in out
    assert read_manifest(page.parent)["command"] == "livlab run small.toml"
    with contextlib.chdir(folder):
        code, again, _ = call("run", "small.toml")
    assert code == 0
    assert "Done before" in again
    assert again.strip().splitlines()[-1] == lines[-1]


def test_a_report_is_built_again_from_its_folder_without_simulating(ran: tuple[Path, str]) -> None:
    folder, out = ran
    page = folder / out.strip().splitlines()[-1]
    first, manifest = page.read_bytes(), page.with_name("manifest.json").read_bytes()
    page.unlink()
    code, said, _ = call("report", str(page.parent))
    assert code == 0
    assert Path(said.strip()) == page
    assert page.read_bytes() == first
    page.unlink()
    with contextlib.chdir(folder):
        _, again, _ = call("run", "-q", "small.toml")
    assert folder / again.strip() == page
    assert page.read_bytes() == first
    assert page.with_name("manifest.json").read_bytes() == manifest


def test_quiet_prints_only_the_paths_of_several_runs_and_out_moves_them(small: Path) -> None:
    (small / "other.toml").write_text(SMALL.replace('name = "small"', 'name = "other"'))
    code, out, _ = call("run", "--quiet", "--out", "else where", "small.toml", "other.toml")
    assert code == 0
    pages = out.strip().splitlines()
    assert len(pages) == 2
    for page, name in zip(pages, ("small", "other"), strict=True):
        assert re.fullmatch(rf"else where/{name}-[0-9a-f]{{12}}/report\.html", page)
        manifest = json.loads((small / page).with_name("manifest.json").read_text())
        assert manifest["command"] == f"livlab run {name}.toml --out 'else where'"


def test_all_files_are_checked_before_the_first_is_run(small: Path) -> None:
    (small / "bad.toml").write_text(SMALL.replace("name =", "nome ="))
    _, _, error = call("run", "small.toml", "bad.toml")
    assert isinstance(error, ConfigError)
    assert "bad.toml" in error.message
    assert not (small / "runs").exists()


def test_a_run_without_a_file_is_a_usage_error(small: Path) -> None:
    code, out, _ = call("run")
    assert code == 2
    assert "FILE" in out


@pytest.mark.parametrize(("made", "message"), [(False, "is no run folder"), (True, "has no readable manifest")])
def test_a_report_of_what_is_no_run_folder_is_told(small: Path, made: bool, message: str) -> None:
    if made:
        (small / "x").mkdir()
    _, _, error = call("report", "x")
    assert isinstance(error, LivlabError)
    assert message in error.message


def test_the_schema_is_json_and_goes_to_a_file_if_asked(small: Path) -> None:
    code, out, _ = call("schema")
    assert code == 0
    assert "wavelengths" in json.loads(out)["$defs"]["SpectralExperiment"]["properties"]
    call("schema", "--out", "schema.json")
    assert json.loads((small / "schema.json").read_text()) == json.loads(out)


def test_plain_progress_says_begin_end_and_the_time_left_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    from livlab.cli import progress

    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    console = Console(width=200, force_terminal=False, record=True)
    told = PlainProgress(console, every_seconds=10)
    for seconds, share in ((0, 0.0), (5, 0.2), (20, 0.25), (25, 0.5), (80, 1.0)):
        clock[0] = float(seconds)
        told.advance("thesis", share, "1 M")
    lines = console.export_text().splitlines()
    assert lines == ["thesis: 0% (1 M)", "thesis: 25%, about 60 s left (1 M)", "thesis: 100%, 80.0 s (1 M)"]


def test_quiet_progress_is_silent(capsys: pytest.CaptureFixture[str]) -> None:
    with watched("x", quiet=True) as told:
        assert isinstance(told, Silent)
        told.begin(["a"])
        told.advance("a", 0.5)
        told.say("no")
    assert capsys.readouterr() == ("", "")


def test_bars_show_each_task_and_all_with_the_time_left() -> None:
    from livlab.cli.progress import BarProgress, bars

    console = Console(width=160, force_terminal=True, record=True, file=io.StringIO())
    with bars(console) as drawn:
        told = BarProgress(drawn, "Liver [1]")
        told.begin(["thesis", "measured"])
        told.advance("thesis", 0.5, "2.0 M samples")
        told.advance("thesis", 0.25)
        told.say("a [note]")
        told.advance("measured", 1.0)
        shares = [(task.description, task.completed, task.total) for task in drawn.tasks]
        assert shares == [("[bold]Liver [1]", 1.5, 2.0), ("  thesis", 0.5, 1.0), ("  measured", 1.0, 1.0)]
    shown = console.export_text()
    for text in ("Liver [1]", "thesis", "50%", "measured", "100%", "left", "a [note]"):
        assert text in shown
