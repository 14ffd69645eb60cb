"""What ships with livlab says where it is from: datasets, the page of their licences, CITATION.cff, py.typed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

import livlab
from livlab import datasets
from livlab.cli import app
from livlab.datasets.licences import licences_page

ROOT = Path(__file__).resolve().parents[3]
OWN = sorted(path.parent.name for path in (ROOT / "datasets").glob("*/meta.toml"))


@pytest.fixture(autouse=True)
def own_datasets_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path))


@pytest.mark.parametrize("name", OWN)
def test_a_dataset_names_source_licence_and_how_it_came(name: str) -> None:
    meta = datasets.load(name).meta
    assert len(meta.licence) > 10
    assert len(meta.source) > 10
    assert meta.read_in
    assert meta.doi or meta.url or "DOI" in meta.notes, "without a link the notes say why"


def test_the_page_of_licences_is_what_the_datasets_say() -> None:
    """`livlab data licences > docs/data-licences.md` writes it anew."""
    result = CliRunner().invoke(app, ["data", "licences"])
    assert result.exit_code == 0
    assert (ROOT / "docs" / "data-licences.md").read_text(encoding="utf-8") == result.output
    assert re.findall(r"^## (\w+)$", result.output, re.MULTILINE) == OWN


def test_a_user_dataset_is_not_on_the_page(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text("wavelength_nm,reflectance\n500,0.1\n600,0.2\n")
    done = CliRunner().invoke(
        app,
        ["data", "add", str(tmp_path / "mine.csv"), "--source", "a test", "--kind", "assumed", "--unit", "1", "--yes"],
    )
    assert done.exit_code == 0, done.output
    assert "mine" in datasets.names()
    assert "## mine" not in licences_page()
    assert "a test" in licences_page(["mine"])


def test_the_citation_is_of_this_version_and_licence() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert re.search(r"^version: (\S+)$", text, re.MULTILINE)[1] == project["version"]  # type: ignore[index]
    assert re.search(r"^license: (\S+)$", text, re.MULTILINE)[1] == project["license"]  # type: ignore[index]
    for key in ("cff-version: 1.2.0", "message: ", "title: livlab", "authors:", "type: software"):
        assert re.search(rf"^{re.escape(key)}", text, re.MULTILINE), key
    assert datasets.load("liver_reduced_scattering_jacques2013").meta.doi in text  # type: ignore[operator]


def test_the_citation_has_the_forms_keys() -> None:
    yaml = pytest.importorskip("yaml")
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    # Required and known keys of the Citation File Format 1.2.0.
    assert {"cff-version", "message", "title", "authors"} <= found.keys()
    assert found["type"] in ("software", "dataset")
    assert all({"name"} <= a.keys() or {"family-names"} <= a.keys() for a in found["authors"])
    for reference in found["references"]:
        assert {"authors", "title", "type"} <= reference.keys()
        assert reference["type"] in ("article", "thesis", "software", "data")
    assert isinstance(found["version"], str), "quote a version that YAML takes for a number"


def test_types_are_told() -> None:
    home = Path(livlab.__file__).parent
    assert (home / "py.typed").is_file()
