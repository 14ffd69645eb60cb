"""Datasets that were damaged, tampered with, renamed or doubled: found, and told by name."""

import hashlib
import shutil
from pathlib import Path

import pytest

from livlab import datasets
from livlab.datasets import load
from livlab.datasets.meta import read_meta
from livlab.errors import DatasetError


@pytest.fixture(autouse=True)
def own_data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path / "mine"))
    return tmp_path / "mine"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A folder with a copy of one built-in dataset under another name."""
    folder = tmp_path / "beside" / "bile_copy"
    shutil.copytree(datasets.builtin_root() / "bile_nachabe2011", folder)
    meta = folder / "meta.toml"
    meta.write_text(meta.read_text().replace('name = "bile_nachabe2011"', 'name = "bile_copy"'))
    return folder


def test_tampered_table_is_refused_even_when_cached(copy: Path) -> None:
    assert len(load("bile_copy", search=[copy.parent])) == 72
    table = copy / "table.csv"
    table.write_text(table.read_text().replace("51.5068", "51.5069", 1))
    with pytest.raises(DatasetError, match=r"has been changed.*Put the original file back"):
        load("bile_copy", search=[copy.parent])
    result = datasets.check("bile_copy", search=[copy.parent])
    assert not result.ok
    assert "has been changed" in result.problem


def _rehash(folder: Path, old_sha: str) -> None:
    digest = hashlib.sha256((folder / "table.csv").read_bytes()).hexdigest()
    meta = folder / "meta.toml"
    meta.write_text(meta.read_text().replace(old_sha, digest))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.replace("314.0", "313.0"), "covers 313 to"),
        (lambda t: t.replace("334.2", "300.0"), "wavelengths must rise, but table row 2"),
        (lambda t: t.replace("334.2", "314.0"), "wavelengths must rise"),
        (lambda t: t.replace("51.5068", ""), "table row 1: not a finite number"),
        (lambda t: t.replace("51.5068", "nan"), "not a finite number"),
        (lambda t: t.replace("51.5068", "many"), "column absorption_per_cm"),
        (lambda t: t.replace("51.5068", "51.5,7"), "table row 1 has 3 cells"),
        (lambda t: t.replace("absorption", "absorbtion"), "columns are"),
        (lambda t: t.splitlines()[0] + "\n", "no rows"),
        (lambda _: "", "columns are none"),
        (lambda t: "\n".join(t.splitlines()[:2]), "two rows or more"),
    ],
)
def test_damage_under_a_right_hash_is_still_found(copy: Path, change: object, says: str) -> None:
    table, sha = copy / "table.csv", read_meta(copy / "meta.toml").sha256
    table.write_text(change(table.read_text()))  # type: ignore[operator]
    _rehash(copy, sha)
    with pytest.raises(DatasetError) as caught:
        load("bile_copy", search=[copy.parent])
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("kind = ", "knid = ", "knid: unknown key"),
        ('kind = "digitised"', 'kind = "guessed"', "kind = 'guessed'"),
        ('doi = "10.', 'doi = "11.', "doi"),
        ("format = 1", "format = 2", "format"),
        ("314.0", "1700.0", "rising positive wavelengths"),
        ("unit = ", "units = ", "units: unknown key"),
        ("relative = 0.04", "relative = nan", "relative"),
        ("relative = 0.04", "relative = -1", "relative"),
        ("[columns.absorption_per_cm]", "[columns.'a b']", "column name 'a b'"),
        ('unit = "nm"', 'unit = "um"', "first column, in nm"),
        ("title", "= title", "not a TOML file"),
        ('name = "bile_copy"', 'name = "other"', "name = 'other'"),
    ],
)
def test_meta_that_does_not_fit_is_refused(copy: Path, old: str, new: str, says: str) -> None:
    meta = copy / "meta.toml"
    text = meta.read_text()
    assert old in text
    meta.write_text(text.replace(old, new, 1))
    with pytest.raises(DatasetError) as caught:
        load("bile_copy", search=[copy.parent])
    assert says in str(caught.value)


def test_missing_table_and_binary_meta(copy: Path) -> None:
    (copy / "table.csv").unlink()
    with pytest.raises(DatasetError, match="cannot be read"):
        load("bile_copy", search=[copy.parent])
    (copy / "meta.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasetError, match="not a TOML file"):
        load("bile_copy", search=[copy.parent])


def test_a_name_never_means_two_tables(copy: Path, own_data_folder: Path) -> None:
    same = own_data_folder / "bile_copy"
    shutil.copytree(copy, same)
    assert len(load("bile_copy", search=[copy.parent])) == 72
    table, sha = same / "table.csv", read_meta(same / "meta.toml").sha256
    table.write_text(table.read_text().replace("51.5068", "50.0", 1))
    _rehash(same, sha)
    with pytest.raises(DatasetError, match="two different datasets"):
        load("bile_copy", search=[copy.parent])


def test_other_folders_beside_datasets_do_no_harm(copy: Path) -> None:
    shutil.copytree(copy, copy.parent / "My Notes")
    shutil.copytree(copy, copy.parent / ".adding-abc")
    (copy.parent / "empty").mkdir()
    (copy.parent / "file.txt").write_text("")
    assert set(datasets.names(search=[copy.parent])) - set(datasets.names()) == {"bile_copy"}
    assert all(result.ok for result in datasets.check_all(search=[copy.parent]))
