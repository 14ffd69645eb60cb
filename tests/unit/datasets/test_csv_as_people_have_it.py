"""Spectra as instruments, spreadsheets and colleagues write them: read right, or refused with what mends it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import livlab
from livlab.datasets.add import add
from livlab.datasets.draft import read_draft
from livlab.errors import InputError
from livlab.kinds.shared.references import load_reference
from livlab.kinds.shared.sections import Reference

ROWS = "500,2.5\n510,3\n520,12.5\n"
OCEAN = (
    "Data from Node 1\n\nDate: Thu Mar 01 12:00:00 CET 2026\nIntegration Time (sec): 1.0E-1\nScans to average, 10\n"
    "Number of Pixels in Spectrum: 3\n>>>>>Begin Spectral Data<<<<<\n"
)


def file(folder: Path, text: str, name: str = "mine.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Lab book 7\nDate: 2026-03-01 12:00\nScans, 10\nWavelength (nm),R (%)\n" + ROWS, "lines 1 to 3 are not of"),
        ("Liver 1,,\nWavelength (nm),R (%),\n" + ROWS.replace("\n", ",\n"), "line 1 is not of the table"),
        ("Wavelength,R\nnm,%\n" + ROWS, "heading in line 1"),
        ("Wavelength,R\n[nm],(%)\n" + ROWS, "heading in line 1"),
        ("\ufeffsep=;\r\nWavelength;%R\r\n" + ROWS.replace(",", ";").replace("\n", "\r\n"), "heading in line 2"),
        ("Wavelength,% R,,\n" + ROWS.replace("\n", ",,\n") + ",,,\n,,,\n", "3 rows of 2 numbers"),
        (",Wavelength,R %\n0,500,2.5\n1,510,3\n2,520,12.5\n", "counts the rows: left out"),
        ("Wavelength,R percent\n520,12.5\n510,3\n500,2.5\n", "rows reversed"),
    ],
)
def test_forms_read_alike(tmp_path: Path, text: str, says: str) -> None:
    draft = read_draft(file(tmp_path, text))
    assert draft.columns["wavelength_nm"].tolist() == [500, 510, 520]
    (name,) = [n for n in draft.columns if n != "wavelength_nm"]
    assert (draft.columns[name].tolist(), draft.units[name]) == ([2.5, 3, 12.5], "%")
    assert any(says in sentence for sentence in draft.understood), draft.understood


def test_an_instruments_file_without_headings(tmp_path: Path) -> None:
    path = file(tmp_path, OCEAN + ROWS.replace(",", "\t"))
    with pytest.raises(InputError, match="--column NAME:UNIT"):
        read_draft(path)
    assert read_draft(path, columns=["reflectance:%"]).columns["reflectance"].tolist() == [2.5, 3, 12.5]
    found = livlab.read_spectrum(path)
    assert found.value.tolist() == [2.5, 3, 12.5]
    assert any("if they are percent" in note for note in found.notes)
    assert livlab.read_spectrum(path, unit="%").value.tolist() == pytest.approx([0.025, 0.03, 0.125])


def test_the_standard_deviation_is_asked_for_by_name(tmp_path: Path) -> None:
    path = file(tmp_path, "nm,R_std (%),R (%)\n500,1,10\n510,2,20\n")
    plain = livlab.read_spectrum(path)
    assert plain.value.tolist() == pytest.approx([0.1, 0.2])
    assert np.isnan(plain.standard_error).all()
    assert any("sd_column='r_std'" in note for note in plain.notes)
    known = livlab.read_spectrum(path, sd_column="r_std", subjects=4)
    assert known.standard_error.tolist() == pytest.approx([0.005, 0.01])
    with pytest.raises(InputError, match="has r_std, r"):
        livlab.read_spectrum(path, sd_column="sd")
    with pytest.raises(InputError, match="whole number, 1 or more"):
        livlab.read_spectrum(path, sd_column="r_std", subjects=0)


@pytest.mark.parametrize("heading", ["absorbance", "OD", "Abs (AU)", "log 1/R"])
def test_an_absorbance_is_no_reflectance(tmp_path: Path, heading: str) -> None:
    path = file(tmp_path, f"nm,{heading}\n500,1.7\n510,1.2\n")
    with pytest.raises(InputError, match=r"is an absorbance.*10\*\*\(-A\)"):
        livlab.read_spectrum(path)
    (name,) = [n for n in read_draft(path).columns if n != "wavelength_nm"]
    assert livlab.read_spectrum(path, name).value.tolist() == [1.7, 1.2]


def test_percent_without_its_sign_is_suspected(tmp_path: Path) -> None:
    path = file(tmp_path, "nm,reflectance\n" + ROWS)
    with pytest.raises(InputError, match=r"looks like percent.*unit=\"%\""):
        livlab.read_spectrum(path)
    assert livlab.read_spectrum(path, unit="%").value.max() == pytest.approx(0.125)


def test_jumbled_rows_and_micrometres_are_named_with_what_python_takes(tmp_path: Path) -> None:
    jumbled = file(tmp_path, "nm,R\n510,0.1\n500,0.2\n520,0.3\n")
    with pytest.raises(InputError, match="sort=True"):
        livlab.read_spectrum(jumbled)
    assert livlab.read_spectrum(jumbled, sort=True).value.tolist() == [0.2, 0.1, 0.3]
    short = file(tmp_path, "wavelength,R\n0.5,0.1\n0.51,0.2\n", "um.csv")
    with pytest.raises(InputError, match='wavelength_unit="um"'):
        livlab.read_spectrum(short)
    assert livlab.read_spectrum(short, wavelength_unit="um").wavelength_nm.tolist() == [500, 510]


def test_a_reference_in_percent_is_compared_as_a_ratio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIVLAB_DATA", str(tmp_path / "data"))
    about = {"title": "t", "source": "me", "kind": "tabulated"}
    add(read_draft(file(tmp_path, "nm,R (%),SD (%)\n500,10,1\n510,20,2\n")), name="mine", **about)
    known = load_reference(Reference(label="mine", dataset="mine", column="r", sd_column="sd", subjects=4))
    mean, sd = known.at(np.array([500.0, 505.0, 520.0]))
    assert sd is not None
    np.testing.assert_allclose(mean, [0.1, 0.15, np.nan])
    np.testing.assert_allclose(sd, [0.01, 0.015, np.nan])
    found = livlab.reference("mine", "r", sd_column="sd", subjects=4)
    assert found.value.tolist() == pytest.approx([0.1, 0.2])
    assert found.standard_error.tolist() == pytest.approx([0.005, 0.01])
    add(read_draft(file(tmp_path, "nm,OD\n500,1\n510,2\n"), unit="1"), name="dark", **about)
    with pytest.raises(InputError, match=r"reference mine.column = 'od': is an absorbance"):
        load_reference(Reference(label="mine", dataset="dark", column="od"))
