"""A user's CSV: forms that are understood, and faults that are named by row and column."""

import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from livlab.datasets.draft import Draft, read_draft
from livlab.datasets.quantity import convert_factor, known_units, parse_unit
from livlab.datasets.readers.raw import RawTable
from livlab.datasets.readers.registry import READERS, Reader, read_table
from livlab.datasets.readers.text import MAX_BYTES, MAX_COLUMNS, MAX_ROWS
from livlab.errors import InputError, LivlabError

PLAIN = "wavelength_nm,reflectance\n500,0.25\n510.5,0.3\n520,0.125\n"


def read(tmp_path: Path, text: str | bytes, **options: object) -> Draft:
    file = tmp_path / "mine.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_draft(file, **options)  # type: ignore[arg-type]


def values(draft: Draft) -> list[list[float]]:
    return [list(column) for column in draft.columns.values()]


@pytest.mark.parametrize(
    ("text", "form"),
    [
        (PLAIN, "comma-separated, decimal point"),
        (PLAIN.replace(",", ";"), "semicolon-separated, decimal point"),
        (PLAIN.replace(",", "\t"), "tab-separated, decimal point"),
        (PLAIN.replace(",", " ; ").replace(".", ","), "semicolon-separated, decimal comma"),
        (PLAIN.replace(",", "\t").replace(".", ","), "tab-separated, decimal comma"),
        (PLAIN.replace(",", "|"), "bar-separated, decimal point"),
        (PLAIN.replace(",", "   "), "separated by blanks, decimal point"),
        (PLAIN.replace(",", " ").replace(".", ","), "separated by blanks, decimal comma"),
        (PLAIN.replace(",", ", "), "comma-separated, decimal point"),
        (PLAIN.replace("\n", "\r\n"), "comma-separated, decimal point"),
        (PLAIN.replace("\n", "\r"), "comma-separated, decimal point"),
        (PLAIN.replace("\n", ",\n"), "comma-separated, decimal point"),
        ("# from the lab\n\n% more\n" + PLAIN + "\n\n", "comma-separated, decimal point"),
        (PLAIN.encode("utf-8-sig"), "UTF-8 with BOM"),
        (PLAIN.encode("utf-16"), "UTF-16"),
        (
            '"wavelength_nm","reflectance"\n"500,0","0,25"\n"510,5","0,3"\n"520,0","0,125"\n',
            "quoted cells, decimal comma",
        ),
        (PLAIN.replace("0.25", "2.5e-1").replace("0.3", "+.3"), "comma-separated, decimal point"),
        (PLAIN.replace("nm", "nm [µm²]").replace("wavelength_nm", "wavelength").encode("cp1252"), "Windows-1252"),
    ],
)
def test_usual_forms_read_alike(tmp_path: Path, text: str | bytes, form: str) -> None:
    draft = read(tmp_path, text, unit="1", wavelength_unit="nm")
    assert values(draft) == [[500.0, 510.5, 520.0], [0.25, 0.3, 0.125]]
    assert any(form in sentence for sentence in draft.understood), draft.understood


def test_without_a_heading(tmp_path: Path) -> None:
    body = PLAIN.split("\n", 1)[1]
    with pytest.raises(InputError, match="--column NAME:UNIT"):
        read(tmp_path, body)
    draft = read(tmp_path, body, columns=["reflectance:%"])
    assert draft.units == {"wavelength_nm": "nm", "reflectance": "%"}
    assert "no heading, 2 columns" in draft.understood
    assert "first column taken as the wavelength" in draft.understood


def test_headings_give_names_and_units(tmp_path: Path) -> None:
    draft = read(tmp_path, "Reflectance (%);SD [%];Wavelength (nm);mua_per_cm\n20;1;500;3\n30;1;510;4\n")
    assert list(draft.columns) == ["wavelength_nm", "reflectance", "sd", "mua_per_cm"]
    assert draft.units == {"wavelength_nm": "nm", "reflectance": "%", "sd": "%", "mua_per_cm": "1/cm"}
    assert draft.headings["reflectance"] == "Reflectance (%)"
    assert list(draft.columns["wavelength_nm"]) == [500.0, 510.0]


@pytest.mark.parametrize("heading", ["lambda (µm)", "Wavelength [um]", "wavelength_um", "Wellenlänge / µm", "um"])
def test_micrometres_by_heading(tmp_path: Path, heading: str) -> None:
    draft = read(tmp_path, f"{heading},n\n0.5005,1.38\n0.6,1.37\n", unit="1")
    assert list(draft.columns["wavelength_nm"]) == [500.5, 600.0]
    assert "wavelengths in um, converted to nm" in draft.understood


def test_micrometres_are_suspected_and_converted_on_demand(tmp_path: Path) -> None:
    text = "wavelength,n\n0.5,1.38\n0.6,1.37\n"
    with pytest.raises(InputError, match=r"look like micrometres.*--wavelength-unit um"):
        read(tmp_path, text)
    assert list(read(tmp_path, text, wavelength_unit="µm").columns["wavelength_nm"]) == [500.0, 600.0]
    with pytest.raises(InputError, match="must be nm or um"):
        read(tmp_path, text, wavelength_unit="cm")


def test_unsorted_is_refused_by_line_and_sorted_on_demand(tmp_path: Path) -> None:
    text = "# c\nwavelength,reflectance\n520,3\n500,1\n510,2\n"
    with pytest.raises(InputError, match=r"line 4, wavelength = 500.0: comes after 520.*--sort"):
        read(tmp_path, text, unit="%")
    assert values(read(tmp_path, text, unit="%", sort=True)) == [[500, 510, 520], [1, 2, 3]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("wavelength,a\n500,1\n510,nan\n", "line 3, column a = 'nan': is not a finite number"),
        ("wavelength,a\n500,1\n510,inf\n", "line 3, column a = 'inf': is not a finite number"),
        ("wavelength,a\n500,1\n510,1e999\n", "line 3, column a = '1e999': is not a finite number"),
        ("wavelength,a\n500,1\n510,#N/A\n", "line 3, column a = '#N/A': is not a finite number"),
        ("wavelength,a\nnan,1\n510,2\n", "line 2, column wavelength = 'nan'"),
        ("wavelength,a\n500,1\n510,abc\n", "line 3, column a = 'abc': is not a number"),
        ("wavelength,a\n500,1_0\n510,1\n", "line 2, column a = '1_0': is not a number"),
        ("wavelength,a\n500,1\n510,\n520,3\n", "line 3, column a = '': is empty"),
        ("wavelength;a\n500;1.234,5\n510;2,5\n", "mixes decimal and thousands marks"),
        ("wavelength,a\n500,1\n510,1,2\n", "line 3 has 3 cells, the heading 2"),
        ("wavelength,a\n5O0,1\n510,2\n520,3\n", "line 2, column wavelength = '5O0': is not a number"),
        ("title\nwavelength,a\nfivehundred,1\n510,2\n", "line 3, column wavelength = 'fivehundred'"),
        ("wavelength,a\n500,1\nmean,2\n510,2\n", "line 3, column wavelength = 'mean'"),
        ("wl,R\n500,0,02\n510,0,03\n", "line 2 has 3 cells, the heading 2"),
        ('wl,counts\n500,"2,002"\n510,"20,100"\n', "may have a decimal comma or mark thousands"),
        ("Wavelength (Å),R\n5000,1\n5100,2\n", "nm = ångström / 10"),
        ("Wavenumber (cm-1),R\n20000,1\n20100,2\n", "nm = 1e7 / wavenumber"),
        ("Wavenumber,R\n20000,1\n20100,2\n", "nm = 1e7 / wavenumber"),
        ("energy (eV),R\n2.0,1\n2.1,2\n", "nm = 1239.84 / photon energy"),
        ("wavelength,a\n500,1\n500.0,2\n510,2\n", "lines 2 and 3, wavelength = 500.0: is given twice"),
        ("wavelength,a\n510,1\n500,2\n510,2\n", "lines 2 and 4, wavelength = 510.0: is given twice"),
        ("wavelength,absorption\n500,1\n510,-0.1\n", "line 3, column absorption = -0.1: must not be negative"),
        ("wavelength,mua_per_cm\n500,1\n510,-0.1\n", "must not be negative"),
        ("wavelength,reflectance [1]\n500,1\n510,43\n", "looks like percent"),
        ("wavelength,a\n500,1\n", "has one row"),
        ("wavelength,a\n", "no two columns of numbers"),
        ("", "is empty"),
        ("  \n \n", "is empty"),
        ("# only\n# words\n", "only comments"),
        ("500\n510\n", "no two columns"),
        ("wavelength,a\n-500,1\n510,2\n", "line 2, wavelength = -500.0: must be 100 to 30000 nm"),
        ("wavelength,a\n0,1\n510,2\n", "must be 100 to 30000 nm"),
        ("wavelength,a\n500,1\n1e9,2\n", "line 3, wavelength = 1000000000.0"),
        ("wavelength,wavelength\n500,1\n510,2\n", "more than one wavelength column"),
        ("wavelength,a,A\n500,1,1\n510,2,2\n", "'a': is used twice"),
        ("wavelength,(!)\n500,1\n510,2\n", "column name"),
        ("wavelength," + "x" * 300 + "\n500,1\n510,2\n", "longer than 200 characters"),
        ("wavelength," + ",".join(f"c{i}" for i in range(MAX_COLUMNS)) + "\n", "no two columns of numbers"),
        ((",".join(["500"] * (MAX_COLUMNS + 1)) + "\n") * 2, f"more than {MAX_COLUMNS} columns"),
        (b"PK\x03\x04rest of a workbook", "a spreadsheet or ZIP archive"),
        (b"\x89PNG\r\n\x1a\n", "an image"),
        (b"\x00\x01\x02,\x03", "control characters"),
        (b"500,\x81\x8d\n510,1\n", "is not a text file"),
        (b"\xff\xfe5\x00,", "is not a text file"),
        ("wavelength,a\n500,\u0665\n510,1\n", "is not a number"),
    ],
)
def test_faults_are_named(tmp_path: Path, text: str | bytes, says: str) -> None:
    with pytest.raises(LivlabError) as caught:
        read(tmp_path, text)
    assert says in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"columns": ["a", "b"]}, "must name 1 column(s)"),
        ({"columns": ["a b"]}, "column name"),
        ({"columns": ["wavelength_nm"]}, "column name"),
        ({"columns": ["a:furlong"]}, "unit of a"),
        ({"unit": "1/inch"}, "is not a unit livlab knows"),
    ],
)
def test_wrong_options(tmp_path: Path, options: dict[str, object], says: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, PLAIN, **options)
    assert says in str(caught.value)


def test_table_of_parameters(tmp_path: Path) -> None:
    draft = read(tmp_path, "theta_deg,phi_deg,brdf [1/sr]\n10,0,0.1\n5,0,0.2\n5,90,-0.0\n", wavelength=False)
    assert not draft.is_spectrum
    assert draft.units == {"theta_deg": None, "phi_deg": None, "brdf": "1/sr"}
    assert list(draft.columns["theta_deg"]) == [10, 5, 5]


@pytest.mark.parametrize("size", [200 * 2**20, MAX_BYTES + 1])
def test_a_huge_file_is_refused_at_once(tmp_path: Path, size: int) -> None:
    file = tmp_path / "huge.csv"
    with file.open("wb") as stream:
        stream.truncate(size)
    start = time.perf_counter()
    with pytest.raises(InputError, match=r"MiB, more than the 8 MiB.*add that file"):
        read_table(file)
    assert time.perf_counter() - start < 0.5


def test_too_many_rows(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"more than the {MAX_ROWS}"):
        read(tmp_path, "500,1\n" * (MAX_ROWS + 1))


def test_the_longest_file_is_read_in_seconds(tmp_path: Path) -> None:
    text = "wavelength,a\n" + "".join(f"{500 + i / 100:.2f},1\n" for i in range(MAX_ROWS - 1))
    start = time.perf_counter()
    assert len(read(tmp_path, text).columns["a"]) == MAX_ROWS - 1
    assert time.perf_counter() - start < 8


def test_what_is_not_a_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_table(tmp_path / "absent.csv")
    with pytest.raises(InputError, match=r"is not a (regular )?file"):
        read_table(tmp_path)
    with pytest.raises(InputError, match="is not a file name"):
        read_table(Path("a\0b"))
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is not a file"):
        read_table(tmp_path / "file" / "x.csv")
    with pytest.raises(LivlabError):
        read_table(tmp_path / ("x" * 5000))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_named_pipe_does_not_hang(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    failed: list[BaseException] = []

    def attempt() -> None:
        try:
            read_table(tmp_path / "pipe")
        except LivlabError as error:
            failed.append(error)

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(5)
    assert not thread.is_alive()
    assert "not a regular file" in str(failed[0])


def test_units_convert_both_ways() -> None:
    assert convert_factor("1/cm", "1/mm") == 0.1
    assert convert_factor("%", "1") == 0.01
    for source in known_units():
        assert parse_unit(source) == source
        for target in known_units():
            try:
                there = convert_factor(source, target)
            except InputError:
                continue
            assert there * convert_factor(target, source) == pytest.approx(1, rel=1e-12)
    assert (parse_unit("cm⁻¹"), parse_unit("µm"), parse_unit("a.u."), parse_unit("m"), parse_unit("M")) == (
        "1/cm",
        "um",
        "1",
        "m",
        "M",
    )
    assert np.isclose(convert_factor("deg", "rad") * 180, np.pi)


@pytest.mark.parametrize(
    "text",
    [
        "500," + "9" * 4_000_000 + "\n510,1\n",
        "(" * 4_000_000 + ",(\n500,1\n510,2\n",
        "1," * 2_000_000,
        "500" + "," * 4_000_000,
        '"' * 4_000_000,
    ],
)
def test_monstrous_cells_are_refused_at_once(tmp_path: Path, text: str) -> None:
    start = time.perf_counter()
    with pytest.raises(InputError):
        read(tmp_path, text, columns=["a:1"])
    assert time.perf_counter() - start < 8


def test_a_long_path_keeps_the_name_of_the_file(tmp_path: Path) -> None:
    folder = tmp_path / ("d" * 100)
    folder.mkdir()
    with pytest.raises(InputError, match=r"dd/absent\.csv'"):
        read_table(folder / "absent.csv")


def test_a_further_reader_is_one_function_and_one_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_toy(path: Path) -> RawTable:
        pairs = np.frombuffer(path.read_bytes()[4:]).reshape(-1, 2)
        rows = tuple((float(a), float(b)) for a, b in pairs)
        lines = tuple(range(1, len(rows) + 1))
        return RawTable(path, ("wavelength", "reflectance"), ("nm", "1"), lines, rows, ("a toy's file",))

    def begins(path: Path, start: bytes) -> bool:
        return start.startswith(b"TOY!")

    monkeypatch.setitem(READERS, "toy", Reader("toy", read_toy, begins, (".toy",)))
    content = b"TOY!" + np.array([[500.0, 0.1], [510.0, 0.2]]).tobytes()
    (tmp_path / "a.TOY").write_bytes(content)
    assert read_draft(tmp_path / "a.TOY").columns["reflectance"].tolist() == [0.1, 0.2]
    (tmp_path / "a.csv").write_bytes(content)  # begins like one, and is called otherwise
    with pytest.raises(InputError, match="control characters"):
        read_draft(tmp_path / "a.csv")
    (tmp_path / "b.toy").write_text("nm,R\n500,0.1\n510,0.2\n")  # called like one, and begins otherwise
    assert read_draft(tmp_path / "b.toy").columns["r"].tolist() == [0.1, 0.2]
    assert READERS["text"].priority == min(reader.priority for reader in READERS.values())
