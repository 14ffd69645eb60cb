"""The report of a picture run and the gallery over several, made from run folders alone."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from picture_fakes import BallCamera, small

from livlab.cli.gallery import finished
from livlab.core.picture_files import png_size
from livlab.errors import ConfigError, InputError
from livlab.kinds import execute as runs
from livlab.kinds.picture import job as picture
from livlab.kinds.picture.gallery import build_gallery
from livlab.kinds.picture.gallery_small import small_copies
from livlab.kinds.picture.gallery_table import picture_table
from livlab.kinds.picture.report_words import colour_words
from livlab.kinds.report import rebuild_report

TITLE = 'readings = ["thesis", "measured"]\ntitle = "A <ball> & more"\nbaselines = ["lambert"]\n'
FAILS = '\n[[criterion]]\nmetric = "lightness"\nreading = "thesis"\nwithin = [0, 10]\n'
_PREPARE = picture.prepare


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = small(FAILS, 'readings = ["thesis", "measured"]\n', TITLE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(picture, "prepare", functools.partial(_PREPARE, make_camera=BallCamera))
        return runs.execute(config, base=tmp_path_factory.mktemp("runs")).folder


def sources(text: str) -> list[str]:
    return re.findall(r'<img[^>]* src="([^"]+)"', text)


def test_the_report_holds_every_picture_and_asks_for_nothing(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert len(sources(text)) == 3
    assert all(s.startswith("data:image/png;base64,") for s in sources(text))
    assert "A &lt;ball&gt; &amp; more" in text
    assert "<script" not in text
    alts = re.findall(r'<img[^>]* alt="([^"]+)"', text)
    assert len(alts) == 3
    assert all(len(a) > 20 for a in alts)
    assert "Fails: lightness thesis is" in text
    assert "each redirection keeping 64 % of the light" in text  # 2/π


def test_the_report_comes_again_from_the_folder_alone(folder: Path) -> None:
    before = (folder / "report.html").read_text(encoding="utf-8")
    assert rebuild_report(folder).read_text(encoding="utf-8") == before


def test_the_gallery_copies_its_pictures_and_names_their_cost(folder: Path, tmp_path: Path) -> None:
    page = build_gallery([folder, folder], tmp_path / "gallery")
    text = page.read_text(encoding="utf-8")
    found = sources(text)
    assert len(found) == 6
    assert len(set(found)) == 6  # one run twice keeps its pictures apart
    for source in found:
        assert (page.parent / source).read_bytes().startswith(b"\x89PNG")
    assert re.search(
        r"thesis reading; the thesis&#39;s colour; parallel light \(level 1\); 12 spp, .* s, relative", text
    )
    assert "Lambert" in text
    assert "1 FAIL" in text
    assert not re.search(r'(?:src|href)="https?:', text)


def test_what_is_no_picture_run_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one run"):
        build_gallery([], tmp_path)
    other = tmp_path / "spectral"
    other.mkdir()
    (other / "manifest.json").write_text('{"kind": "spectral"}')
    (other / "config.toml").write_text("schema = 1")
    with pytest.raises(InputError, match="holds no pictures"):
        build_gallery([other], tmp_path / "out")


def test_runs_are_found_by_name_the_latest_first(folder: Path, tmp_path: Path) -> None:
    assert finished(folder.parent) == [folder]
    assert finished(tmp_path / "nowhere") == []


def test_the_command_says_where_the_page_is(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from livlab.cli.app import app

    done = CliRunner().invoke(app, ["gallery", str(folder), "--out", str(tmp_path / "g")])
    assert done.exit_code == 0
    assert Path(done.stdout.strip()).is_file()
    monkeypatch.chdir(tmp_path)
    nothing = CliRunner().invoke(app, ["gallery"])
    assert isinstance(nothing.exception, ConfigError)


@pytest.mark.parametrize(
    ("colour", "words"),
    [
        ((25, 20, 35), "dark reddish brown"),
        ((70, 30, 85), "light yellow"),
        ((50, 30, 10), "medium purplish red"),
        ((8, 1, 0), "very dark grey"),
    ],
)
def test_colours_in_words(colour: tuple[float, float, float], words: str) -> None:
    assert colour_words(*colour) == words


def test_an_unfinished_run_says_so(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from livlab.errors import Interrupted
    from livlab.kinds.report import build_report

    class Stopped(BallCamera):
        def expose(self, film: Any, stack: Any, *, spp: int, seed: int) -> None:
            raise Interrupted("Stopped.")

    monkeypatch.setattr(picture, "prepare", functools.partial(_PREPARE, make_camera=Stopped))
    with pytest.raises(Interrupted):
        runs.execute(small(), base=tmp_path, report=False)
    (partial,) = tmp_path.iterdir()
    text = build_report(partial).read_text(encoding="utf-8")
    assert "This run is not complete" in text
    assert "No picture is finished yet" in text
    with pytest.raises(InputError, match="no finished picture"):
        build_gallery([partial], tmp_path / "gallery")


def test_the_table_has_the_numbers_of_every_picture(folder: Path) -> None:
    head, _, *rows = picture_table([folder]).splitlines()
    assert [x.strip() for x in head.strip("|").split("|")][:3] == ["run", "tissue", "reading"]
    cells = [[x.strip() for x in row.strip("|").split("|")] for row in rows]
    assert [c[2] for c in cells] == ["thesis", "measured"]
    colours = pd.read_csv(folder / "colours.csv").set_index("reading")
    for c in cells:
        assert c[4:6] == ["12", "6"]
        assert float(c[9]) == pytest.approx(colours.loc[c[2], "L"], abs=0.05)
        assert float(c[11]) == pytest.approx(colours.loc[c[2], "b"], abs=0.05)


def test_small_copies_are_of_each_picture_and_small(folder: Path, tmp_path: Path) -> None:
    made = small_copies([folder], tmp_path, 16)
    assert [p.name for p in made] == ["small-thesis.png", "small-measured.png"]
    assert all(png_size(p) == (16, 11) for p in made)
