"""docs/adding-an-organ.md as its reader follows it: the files it writes, the commands and the Python it shows."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from livlab.cli import app
from livlab.config import builtin_experiments, load_experiment
from livlab.model.tissue.presets import read_preset

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "adding-an-organ.md"
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)


def test_every_block_of_the_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, libllvm: object) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path / "data"))
    names: dict[str, object] = {}
    blocks = BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    assert len(blocks) == PAGE.read_text(encoding="utf-8").count("\n```") / 2
    done = {"toml": 0, "csv": 0, "sh": 0, "python": 0}
    for language, title, body in blocks:
        if title:
            with Path(title).open("a", encoding="utf-8") as stream:  # a file is written in pieces
                stream.write(body + "\n")
        elif language == "sh":
            for line in body.splitlines():
                program, *words = shlex.split(line)
                assert program == "livlab"
                result = CliRunner().invoke(app, words)
                assert result.exit_code == 0, (line, result.output, result.exception)
        else:
            assert language == "python"
            exec(compile(body, f"{PAGE.name}, {body.splitlines()[0]}", "exec"), names)
        done[language] += 1
    assert all(done.values())
    assert load_experiment(Path("picture.toml")).plain()["kind"] == "picture"


def test_the_picture_of_the_tutorial_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, libllvm: object) -> None:
    monkeypatch.chdir(tmp_path)
    for _, title, body in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if title in ("my-skin.toml", "picture.toml"):
            with Path(title).open("a", encoding="utf-8") as stream:
                stream.write(body + "\n")
    result = CliRunner().invoke(app, ["run", "picture.toml"])
    assert result.exit_code == 0, (result.output, result.exception)
    page = next(tmp_path.glob("runs/skin-ball-*/report.html")).read_text(encoding="utf-8")
    assert "Absorption coefficient of the dermis" in page
    assert "above it lies the epidermis" in page


def test_the_skin_of_the_tutorial_is_the_preset(tmp_path: Path) -> None:
    """The page's numbers are the preset's, so that neither drifts from the sources alone."""
    text = "".join(
        body for _, title, body in BLOCK.findall(PAGE.read_text(encoding="utf-8")) if title == "my-skin.toml"
    )
    (tmp_path / "my-skin.toml").write_text(text, encoding="utf-8")
    mine, own = read_preset(tmp_path / "my-skin.toml").build(), read_preset("skin").build()
    assert [x.name for x in mine.layers] == [x.name for x in own.layers]
    for a, b in zip(mine.layers, own.layers, strict=True):
        assert (a.thickness_mm, a.index) == (b.thickness_mm, b.index)
        for name in a.elements.keys() | b.elements.keys():
            x, y = (layer.elements[name].model_dump(exclude={"sources"}) for layer in (a, b))
            if (a.name, name) == ("dermis", "baseline"):  # the page leaves room for a pigment
                x.pop("fraction"), y.pop("fraction")
            assert x == y


@pytest.mark.parametrize("where", ["beside", "elsewhere"])
def test_a_preset_file_is_found_beside_its_experiment_from_anywhere(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "meus órgãos"
    (home / "presets").mkdir(parents=True)
    (home / "presets" / "pele.toml").write_text(
        (ROOT / "livlab/model/tissue/preset_files/skin.toml").read_text(encoding="utf-8"), encoding="utf-8"
    )
    text = builtin_experiments()["spectral-skin"].read_text(encoding="utf-8")
    (home / "mine.toml").write_text(text.replace('preset = "skin"', 'preset = "presets/pele.toml"'), encoding="utf-8")
    monkeypatch.chdir(home if where == "beside" else tmp_path)
    experiment = load_experiment(Path("mine.toml") if where == "beside" else Path("meus órgãos") / "mine.toml")
    assert experiment.resolve() == load_experiment("spectral-skin").resolve()
