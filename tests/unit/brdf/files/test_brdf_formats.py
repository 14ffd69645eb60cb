"""The table of BRDF formats: rows that hold, a page that lists them, and a further format in one file and one row."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fuzz.brdf_seeds import SEEDS
from fuzz.targets import TARGETS
from livlab.brdf.files.formats import convert, read_brdf, write_brdf
from livlab.brdf.files.interface import FileFunctions
from livlab.brdf.files.registry import (
    FORMATS,
    Format,
    format_to_read,
    formats_table,
    in_words,
    read_suffixes,
    sources_in_words,
    written_suffixes,
)
from livlab.brdf.samples import sample_dataset
from livlab.errors import InputError

ROOT = Path(__file__).resolve().parents[4]
TOY = """
from livlab.brdf.files.interface import FileFunctions
from livlab.brdf.samples import sample_dataset
from livlab.brdf.table import as_samples

def read(path):
    rows = [[float(x) for x in line.split()] for line in path.read_text().splitlines()]
    return sample_dataset([r[:3] for r in rows], [r[3:6] for r in rows], [r[6:] for r in rows], channels=["L"])

def write(path, data, holes):
    s = as_samples(data)
    rows = zip(s["wi"].values, s["wo"].values, s["value"].values)
    path.write_text("".join(" ".join(map(repr, map(float, (*a, *b, *v)))) + "\\n" for a, b, v in rows))

def write_function(path, function):
    raise NotImplementedError

FILE = FileFunctions(read, write, write_function)
"""


@pytest.fixture
def toy(tmp_path, monkeypatch):
    (tmp_path / "toy_brdf_format.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    row = Format("toy", (".toy",), "toy_brdf_format", "seven numbers a line", "other numbers of them")
    monkeypatch.setitem(FORMATS, "toy", row)
    yield row
    sys.modules.pop("toy_brdf_format", None)


@pytest.mark.parametrize("name", FORMATS)
def test_a_row_and_its_module_agree(name):
    row = FORMATS[name]
    assert (row.functions().write is not None) == (row.written is True)
    assert name in SEEDS
    assert TARGETS[f"brdf-{name}"].files == (f"x{row.suffixes[0]}",)


def test_no_suffix_stands_in_two_rows():
    assert len(set(read_suffixes())) == len(read_suffixes())
    assert set(written_suffixes()) < set(read_suffixes())


def test_the_page_lists_every_format():
    """`python -c "from livlab.brdf.files.registry import *; print(formats_table())"` writes it anew."""
    assert formats_table() in (ROOT / "docs" / "brdf.md").read_text(encoding="utf-8")


def test_the_words_are_those_of_the_rows(toy):
    assert in_words() == ".nc, .csv, .binary, .bsdf or .toy"
    assert in_words(last="") == ".nc, .csv, .binary, .bsdf, .toy"
    assert sources_in_words() == ".nc, .csv, .binary, .bsdf, .alta, .txt, a fit's .json, or .toy"
    assert "| `.toy` | yes | yes | seven numbers a line | other numbers of them |" in formats_table()


def test_a_further_format_is_one_file_and_one_row(toy, tmp_path):
    way = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    samples = sample_dataset(way, way[::-1], np.array([[0.3], [0.4]]), channels=["L"])
    write_brdf(tmp_path / "a.toy", samples)
    convert(tmp_path / "a.toy", tmp_path / "b.csv")
    convert(tmp_path / "b.csv", tmp_path / "c.TOY")
    assert (tmp_path / "c.TOY").read_text() == (tmp_path / "a.toy").read_text()
    np.testing.assert_array_equal(read_brdf(tmp_path / "c.TOY")["value"], samples["value"])


def test_what_is_forgotten_is_an_error(toy, monkeypatch):
    with pytest.raises(TypeError, match="both write and write_function"):
        FileFunctions(read_brdf, write_brdf)
    monkeypatch.setitem(FORMATS, "toy", Format("toy", (".toy",), "toy_brdf_format", "", "", written=False))
    with pytest.raises(TypeError, match="disagree"):
        format_to_read(Path("a.toy")).functions()
    with pytest.raises(InputError, match=r"must end in one of .nc, .csv, .binary, .bsdf, .alta"):
        format_to_read(Path("a.none"))
