"""A table of text as people have it: any usual delimiter, decimal comma, BOM, heading or none; says what it understood.

Numbers are never guessed: a cell that is not a plain finite number is an error that names its row and column.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections import Counter
from pathlib import Path

from livlab.datasets.heading import Line, find_table, number_led
from livlab.datasets.readers.raw import RawTable, shown, whole
from livlab.errors import InputError

MAX_BYTES = 8 * 1024 * 1024
MAX_ROWS = 100_000
MAX_COLUMNS = 64
_MAX_HEADING = 200
_MAX_NUMBER = 100
_EMPTY = ' \t\f\v,;|"'

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity|n/?a|null|none|#n/a|#value!|#div/0!)", re.IGNORECASE)
_EXCEL_SEPARATOR = re.compile(r"sep=.\s*", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII)
_BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig", "UTF-8 with BOM"),
    (codecs.BOM_UTF16_LE, "utf-16", "UTF-16"),
    (codecs.BOM_UTF16_BE, "utf-16", "UTF-16"),
)
_MAGIC = (
    (b"PK\x03\x04", "a spreadsheet or ZIP archive"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"%PDF", "a PDF"),
    (b"\x89PNG", "an image"),
    (b"\xff\xd8\xff", "an image"),
    (b"\x89HDF", "an HDF5 or NetCDF file"),
    (b"CDF", "a NetCDF file"),
)
# (delimiter, decimal mark, in words); None splits at blanks.
_DIALECTS: tuple[tuple[str | None, str, str], ...] = (
    (",", ".", "comma-separated, decimal point"),
    (";", ".", "semicolon-separated, decimal point"),
    ("\t", ".", "tab-separated, decimal point"),
    (";", ",", "semicolon-separated, decimal comma"),
    ("\t", ",", "tab-separated, decimal comma"),
    ("|", ".", "bar-separated, decimal point"),
    (None, ".", "separated by blanks, decimal point"),
    (None, ",", "separated by blanks, decimal comma"),
    (",", ",", "comma-separated quoted cells, decimal comma"),
)
_TOO_MUCH_REMEDY = "Keep the columns and wavelengths that you need (every nm is plenty), and add that file."
_AS_TEXT_REMEDY = "Export the table as a plain CSV file (comma, semicolon or tab) and add that."


def read_text(path: Path) -> RawTable:
    """Read a numeric table from a text file of any usual form.

    Raises
    ------
    InputError
        If the file is missing, not a plain text table, too large, empty, or has a cell that is not a finite number.
    EnvironmentProblem
        If it cannot be read.
    """
    text, notes = _text(path)
    words, lines, decimal = _split(path, text)
    notes.append(words)
    found = find_table(
        lines, lambda cell: _value(cell, decimal) is not None, lambda cell: _NOT_FINITE.fullmatch(cell) is not None
    )
    notes += found.told()
    if not found.rows:
        raise InputError.of("file", shown(path), "has a heading and no rows", "Give at least two rows of numbers.")
    headings, units, body = _trimmed(path, found.heading, found.units, found.rows)
    notes.append(
        f"no heading, {len(body[0][1])} columns"
        if headings is None or found.heading is None
        else f"heading in line {found.heading[0]}: {', '.join(headings)}"
    )
    width = len(headings or body[0][1])
    _refuse_thousands(path, words, body)
    body_lines, body_rows = [], []
    for number, cells in body:
        if len(cells) != width:
            raise _bad(path, number, len(cells), width, "the heading" if headings else "the first row", words)
        body_lines.append(number)
        body_rows.append(
            tuple(
                _number(path, number, headings[i] if headings else f"{i + 1}", cell, decimal)
                for i, cell in enumerate(cells)
            )
        )
    notes.append(f"{len(body_rows)} rows of {width} numbers")
    return RawTable(path, headings, units, tuple(body_lines), tuple(body_rows), tuple(notes))


def _text(path: Path) -> tuple[str, list[str]]:
    content = whole(path, MAX_BYTES, _TOO_MUCH_REMEDY)
    if not content.strip():
        raise InputError.of("file", shown(path), "is empty", "Give a CSV with wavelengths and values.")
    for magic, what in _MAGIC:
        if content.startswith(magic):
            raise InputError.of("file", shown(path), f"is {what}, not a text table", _AS_TEXT_REMEDY)
    found = next((entry for entry in _BOMS if content.startswith(entry[0])), None)
    # Without a mark: UTF-8, or what old spreadsheets write in the west.
    choices = [found[1:]] if found else [("utf-8", ""), ("cp1252", "not UTF-8: read as Windows-1252")]
    for encoding, words in choices:
        try:
            return _printable(path, content.decode(encoding)), [words] if words else []
        except UnicodeDecodeError:
            continue
    raise InputError.of("file", shown(path), "is not a text file", _AS_TEXT_REMEDY)


def _printable(path: Path, text: str) -> str:
    bad = sum(1 for c in text if ord(c) < 32 and c not in "\t\n\r\f\v")
    if bad:
        raise InputError.of("file", shown(path), f"has {bad} control characters: not a text table", _AS_TEXT_REMEDY)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _split(path: Path, text: str) -> tuple[str, list[Line], str]:
    kept = [
        (i, line)
        for i, line in enumerate(text.split("\n"), start=1)
        if line.strip(_EMPTY) and line.lstrip()[0] not in "#%"
    ]
    if kept and _EXCEL_SEPARATOR.fullmatch(kept[0][1].strip('"')):  # which Excel writes for itself
        kept = kept[1:]
    if not kept:
        raise InputError.of(
            "file", shown(path), "has no table, only comments", "Give a CSV with wavelengths and values."
        )
    if len(kept) > MAX_ROWS:
        raise InputError.of(
            "file",
            shown(path),
            f"has {len(kept)} rows, more than the {MAX_ROWS} that a spectrum may have",
            _TOO_MUCH_REMEDY,
        )
    # The dialect is judged on a sample, so that a long file costs one pass, not eight; and on rows of numbers, where
    # there are any, since what an instrument writes before them has commas and colons of its own.
    sample = [*kept[:200], *kept[-50:]]
    sample = [(i, line) for i, line in sample if number_led(line)] or sample
    best, best_score = None, (0.0, 0)
    for dialect in _DIALECTS:
        split = _cells(sample, dialect[0])
        widths = Counter(len(cells) for _, cells in split)
        width, _ = max(widths.items(), key=lambda item: (item[1], item[0]))
        if width < 2:
            continue
        judged = [cell for _, cells in split for cell in cells[:MAX_COLUMNS]]
        fit = sum(1 for cell in judged if _value(cell, dialect[1]) is not None) / len(judged)
        if fit > best_score[0]:
            best, best_score = dialect, (fit, width)
    if best is None:
        raise InputError.of(
            "file",
            shown(path),
            "has no two columns of numbers",
            "Separate the columns by comma, semicolon or tab: wavelength first, then the values.",
        )
    lines = _cells(kept, best[0])
    if max(len(cells) for _, cells in lines) > MAX_COLUMNS:
        raise InputError.of(
            "file",
            shown(path),
            f"has more than {MAX_COLUMNS} columns",
            "Keep the columns that you need, and add that file.",
        )
    return best[2], lines, best[1]


def _cells(lines: list[tuple[int, str]], delimiter: str | None) -> list[Line]:
    if delimiter is None:
        return [(number, line.split()) for number, line in lines]
    split = []
    for number, line in lines:
        try:
            (cells,) = csv.reader(io.StringIO(line), delimiter=delimiter)
        except (csv.Error, ValueError):
            cells = line.split(delimiter)
        split.append((number, [cell.strip() for cell in cells]))
    return split


def _value(cell: str, decimal: str) -> float | None:
    if len(cell) > _MAX_NUMBER:
        return None
    if decimal == ",":
        if "." in cell:
            return None
        cell = cell.replace(",", ".", 1)
    cell = cell.replace("\u2212", "-", 1)
    return float(cell) if _NUMBER.fullmatch(cell) else None


def _trimmed(
    path: Path, heading: Line | None, units: tuple[str | None, ...], rows: list[Line]
) -> tuple[tuple[str, ...] | None, tuple[str | None, ...], list[Line]]:
    """Headings, units and rows without empty columns at the end, which spreadsheets leave."""
    every = [*([heading] if heading else []), *rows]
    empty = 0
    while all(len(cells) > 2 + empty and not cells[-1 - empty] for _, cells in every):
        empty += 1
    if empty:
        rows = [(number, cells[:-empty]) for number, cells in rows]
    if heading is None:
        return None, (None,) * len(rows[0][1]), rows
    names = heading[1][: len(heading[1]) - empty]
    for cell in names:
        if len(cell) > _MAX_HEADING:
            raise InputError.of(
                f"{path.name}: line {heading[0]}",
                cell,
                f"is longer than {_MAX_HEADING} characters",
                "Shorten the heading.",
            )
    return tuple(names), units[: len(names)], rows


def _refuse_thousands(path: Path, words: str, rows: list[Line]) -> None:
    """Refuse "2,002" between quotes in a comma-separated file, which may be 2.002 or 2002."""
    if "quoted cells" not in words:
        return
    with_comma = [(number, cell) for number, cells in rows for cell in cells if "," in cell]
    if with_comma and all(_THOUSANDS.fullmatch(cell) for _, cell in with_comma):
        number, cell = with_comma[0]
        raise InputError.of(
            f"{path.name}: line {number}",
            cell,
            "may have a decimal comma or mark thousands",
            "Write plain numbers: 2.002, or 2002; or separate the columns by semicolon if it is a decimal comma.",
        )


def _number(path: Path, line: int, column: str, cell: str, decimal: str) -> float:
    value = _value(cell, decimal)
    where = f"{path.name}: line {line}, column {column}"
    if value is not None and math.isfinite(value):
        return value
    if not cell:
        raise InputError.of(where, cell, "is empty", "Fill the cell in or remove the row.")
    if value is not None or _NOT_FINITE.fullmatch(cell):
        raise InputError.of(where, cell, "is not a finite number", "Correct the cell or remove the row.")
    if len(re.findall(r"[.,']", cell)) > 1 or (decimal == "," and "." in cell):
        raise InputError.of(where, cell, "mixes decimal and thousands marks", "Write plain numbers such as 1234.5.")
    raise InputError.of(where, cell, "is not a number", "Correct the cell or remove the row; comments start with #.")


def _bad(path: Path, line: int, cells: int, width: int, than: str, words: str) -> InputError:
    mend = "Give every row the same number of cells, one heading line at most."
    if words.startswith("comma") and cells > width:
        mend = "If the numbers have decimal commas, separate the columns by semicolon or tab."
    return InputError(f"{path.name}: line {line} has {cells} cells, {than} {width}.", remedy=mend)
