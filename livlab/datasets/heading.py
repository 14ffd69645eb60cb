"""Where the numbers of a user's file begin: what an instrument wrote before them, the heading, the row of units."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from livlab.datasets.quantity import parse_unit

Line = tuple[int, list[str]]
"""Number of the line, as an editor counts, and its cells."""

UNIT_IN_NAME = re.compile(r"^(.*?)\s*[\[(]\s*([^\[\]()]*(?:\([^()]*\))?)\s*[\])]\s*$")
_NUMBER_LED = re.compile(r"""[\s"']*[+\-\u2212]?[.,]?\d""")
_PERCENT = re.compile(r"(^%|%$|[_ ](percent|pct)$|^(percent|pct)[_ ])", re.IGNORECASE)


@dataclass(frozen=True)
class Found:
    """A table within a file.

    Attributes
    ----------
    heading
        The line of the headings; None if there is none.
    units
        Unit of each column by the heading or a row of units, None where neither says one; empty without a heading.
    rows
        Lines of numbers, as far as can be told.
    before
        Numbers of the lines left out before the table.
    """

    heading: Line | None
    units: tuple[str | None, ...]
    rows: list[Line]
    before: tuple[int, ...]

    def told(self) -> list[str]:
        """What was left out, in sentences."""
        if not self.before:
            return []
        first, last = self.before[0], self.before[-1]
        if first == last:
            return [f"line {first} is not of the table and was left out"]
        return [f"lines {first} to {last} are not of the table and were left out"]


def number_led(text: str) -> bool:
    """Whether a line begins as a row of numbers does.

    >>> number_led('"500,5";1'), number_led("Date: 2026-03-01")
    (True, False)
    """
    return _NUMBER_LED.match(text) is not None


def find_table(lines: Sequence[Line], is_number: Callable[[str], bool], is_gap: Callable[[str], bool]) -> Found:
    """Part the lines into what stands before the table, its heading and its rows.

    The table begins at the first line that could be a row, also a faulty one: a fault is to be named and not skipped.

    Parameters
    ----------
    lines
        Those of the file, comments aside.
    is_number, is_gap
        Whether a cell is a number, and whether it stands for one that is missing (``nan``).
    """

    def value(cell: str) -> bool:
        return is_number(cell) or is_gap(cell)

    first = next((k for k, (_, cells) in enumerate(lines) if value(cells[0])), None)
    if first is None:  # no row of numbers at all: the first line is the heading, and the reader names the fault below
        return Found(lines[0], units_of(lines[0][1]), list(lines[1:]), ())
    width = len(lines[first][1])

    def faulty_row(k: int) -> bool:
        cells = lines[k][1]
        slip = len(cells) == width > 1 and any(map(value, cells[1:]))
        return slip and (k == first - 1 or number_led(cells[0]))

    start = next((k for k in range(1, first) if faulty_row(k)), first)
    if start == 0:
        return Found(None, (), list(lines), ())
    head = start - 1
    cells = lines[head][1]
    if len(cells) == 1 < width:  # a title, a line such as "begin of data": no headings
        return Found(None, (), list(lines[start:]), tuple(n for n, _ in lines[:start]))
    units = units_of(cells)
    if head and _row_of_units(cells) and len(lines[head - 1][1]) == len(cells) and all(lines[head - 1][1]):
        head -= 1
        units = tuple(parse_unit(cell.strip("[]()")) if cell else None for cell in cells)
    return Found(lines[head], units, list(lines[start:]), tuple(n for n, _ in lines[:head]))


def units_of(cells: Sequence[str]) -> tuple[str | None, ...]:
    """Unit within each heading: in brackets, or a percent sign at either end.

    >>> units_of(["Wavelength (nm)", "%R", "Reflectance, %", "n"])
    ('nm', '%', '%', None)
    """
    return tuple(_unit_of(cell) for cell in cells)


def _unit_of(cell: str) -> str | None:
    match = UNIT_IN_NAME.match(cell)
    if match and match.group(2):
        return parse_unit(match.group(2))
    return "%" if _PERCENT.search(cell.strip()) else None


def _row_of_units(cells: Sequence[str]) -> bool:
    """Whether a line holds units alone, two or more, or one and empty cells.

    >>> _row_of_units(["nm", "%"]), _row_of_units(["[nm]", ""]), _row_of_units(["nm", "R"])
    (True, True, False)
    """
    return all(not cell or parse_unit(cell.strip("[]()")) for cell in cells) and any(cells)
