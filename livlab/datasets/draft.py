"""A user's CSV, validated: which column is the wavelength, names and units, order, range and sign of the values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from livlab.datasets.heading import UNIT_IN_NAME
from livlab.datasets.meta import COLUMN_PATTERN, WAVELENGTH
from livlab.datasets.quantity import parse_unit, require_unit
from livlab.datasets.readers.raw import RawTable, shown
from livlab.datasets.readers.registry import read_table
from livlab.errors import InputError
from livlab.units import FloatArray

SHORTEST_NM, LONGEST_NM = 100.0, 30_000.0
# No wavelength of light that livlab deals in is this short, so such numbers are micrometres.
_SURELY_UM = 31.0
_WAVELENGTH_HEADING = re.compile(r"(wave_?length|lambda|wl|wellenl|longueur_d|nm$|um$|comprimento_de_onda)")
_NOT_NEGATIVE = re.compile(
    r"(absorption|scattering|extinction|refle(ct|kt|x)|transmi|attenuation|absorban|_sd$|_share)"
)
_RATIO = re.compile(r"(refle[ck]tan|reflexion|transmittan|fraction|albedo)")
_NM_PER = {"nm": 1.0, "um": 1e3}
_TO_NM = {
    "1/cm": "nm = 1e7 / wavenumber in 1/cm",
    "a": "nm = ångström / 10",
    "ev": "nm = 1239.84 / photon energy in eV",
    "thz": "nm = 299792.458 / frequency in THz",
}
_OTHER_AXES = {
    "1/cm": re.compile(r"(wave_?number|wellenzahl|nombre_d_onde|raman_shift)"),
    "ev": re.compile(r"(photon_)?energy"),
    "thz": re.compile(r"frequency"),
}


@dataclass(frozen=True)
class Draft:
    """A validated table that still wants a name and a source.

    Attributes
    ----------
    columns
        Column name to values, the wavelength (nm, rising) first where there is one.
    units
        Column name to unit; None where neither the file nor an option gave one.
    headings
        Column name to the file's own heading, where it had one.
    understood
        How the file was read, in sentences, to be shown before anything is written.
    """

    source_file: Path
    columns: dict[str, FloatArray]
    units: dict[str, str | None]
    headings: dict[str, str]
    understood: tuple[str, ...]

    @property
    def is_spectrum(self) -> bool:
        """Whether the table has a wavelength axis."""
        return WAVELENGTH in self.columns

    def with_units(self, units: dict[str, str]) -> Draft:
        """Return the draft with units filled in, checked against the values again."""
        draft = replace(self, units={**self.units, **units})
        for name, values in draft.columns.items():
            _check_values(self.source_file, name, draft.units[name], values, lines=None)
        return draft


def read_draft(
    path: str | Path,
    *,
    columns: Sequence[str] = (),
    unit: str | None = None,
    wavelength_unit: str | None = None,
    sort: bool = False,
    wavelength: bool = True,
    nameless: bool = False,
) -> Draft:
    """Read and validate a user's CSV.

    Parameters
    ----------
    path
        Text table of any usual form (see `livlab.datasets.readers.text`).
    columns
        Names of the columns after the wavelength, in the file's order, each ``NAME`` or ``NAME:UNIT``; they take
        the place of the file's headings.
    unit
        Unit of every column that has none of its own.
    wavelength_unit
        ``nm`` or ``um``; what the heading says, else nm, if absent.
    sort
        Sort rows that are in no order of wavelength, instead of refusing them; falling ones are reversed unasked.
    wavelength
        False for a table of parameters, without a wavelength axis.
    nameless
        Take a file without headings: its columns are ``column_2``, ``column_3``, and so on.

    Raises
    ------
    InputError
        If a cell, the order or range of the wavelengths, a column name or a unit is not valid; the line is named.
    EnvironmentProblem
        If the file cannot be read.
    """
    path = Path(path)
    raw = read_table(path)
    notes = list(raw.understood)
    values = np.array(raw.rows, dtype=np.float64)
    axis = _axis(raw, notes) if wavelength else None
    order = [i for i in range(raw.width) if i != axis and not _counts_rows(raw, i, values, notes)]
    if not order:
        raise InputError.of("file", shown(path), "has no column beside the wavelength", "Add a column of values.")
    if nameless and raw.headings is None and not columns:
        columns = [f"column_{i + 1}" for i in order]
    names, units = _names(raw, order, columns, unit)
    lines = np.array(raw.lines)
    table: dict[str, FloatArray] = {}
    if axis is not None:
        factor = _NM_PER[_wavelength_unit(raw, axis, wavelength_unit, notes)]
        # Rounded: 0.5005 um is 500.5 nm, not 500.49999999999994.
        nm = np.round(values[:, axis] * factor, 9)
        falling = bool(len(nm) > 1 and (np.diff(nm) < 0).all())  # as many instruments write them: nothing to ask
        rising = _check_wavelengths(path, values[:, axis], nm, lines, sort=sort or falling, converted=factor != 1.0)
        if not np.array_equal(rising, np.arange(len(nm))):
            notes.append("wavelengths fall: rows reversed" if falling else "rows sorted by wavelength")
        values, lines = values[rising], lines[rising]
        table[WAVELENGTH] = nm[rising]
        units = {WAVELENGTH: "nm", **units}
    for name, index in zip(names, order, strict=True):
        _check_values(path, name, units[name], values[:, index], lines)
        table[name] = np.ascontiguousarray(values[:, index])
    headings = {n: raw.headings[i] for n, i in zip(names, order, strict=True)} if raw.headings else {}
    return Draft(path, table, units, headings, tuple(notes))


def _axis(raw: RawTable, notes: list[str]) -> int:
    if raw.headings is None:
        notes.append("first column taken as the wavelength")
        return 0
    found = [i for i, heading in enumerate(raw.headings) if _WAVELENGTH_HEADING.match(_slug(heading))]
    if len(found) > 1:
        raise InputError.of(
            "heading", list(raw.headings), "names more than one wavelength column", "Keep one wavelength column."
        )
    axis = found[0] if found else 0
    notes.append(f"column {raw.headings[axis] or 1} {'is' if found else 'taken as'} the wavelength")
    return axis


def _counts_rows(raw: RawTable, column: int, values: FloatArray, notes: list[str]) -> bool:
    """Whether a column without a heading counts the rows, as pandas writes them."""
    if raw.headings is None or raw.headings[column].strip() or len(values) < 2:
        return False
    counted = bool((np.diff(values[:, column]) == 1.0).all() and values[0, column] in (0.0, 1.0))
    if counted:
        notes.append(f"column {column + 1} has no heading and counts the rows: left out")
    return counted


def _wavelength_unit(raw: RawTable, axis: int, asked: str | None, notes: list[str]) -> str:
    heading = raw.headings[axis] if raw.headings else ""
    ending = heading.lower().replace("µ", "u").replace("μ", "u")
    said = raw.units[axis] or ("um" if re.search(r"(^|[_/ .])(um|micron(s)?)$", ending) else None)
    if said is None:
        bracket = UNIT_IN_NAME.match(ending)
        written = bracket.group(2).replace("å", "a").removesuffix("ngstrom").removesuffix("ngström") if bracket else ""
        other = next((unit for unit, pattern in _OTHER_AXES.items() if pattern.match(_slug(heading))), None)
        said = written if written in _TO_NM else other
    unit = parse_unit(asked) if asked is not None else said or "nm"
    if unit not in _NM_PER:
        mend = f"Convert the column: {_TO_NM[unit]}." if unit in _TO_NM else "Give --wavelength-unit nm or um."
        where = "wavelength unit" if asked is not None else f"{raw.source.name}: column {heading}, wavelength unit"
        raise InputError.of(where, asked or unit, "must be nm or um", mend)
    notes.append(f"wavelengths in {unit}" + (", converted to nm" if unit == "um" else ""))
    return unit


def _check_wavelengths(
    path: Path, written: FloatArray, nm: FloatArray, lines: NDArray[np.int64], *, sort: bool, converted: bool
) -> NDArray[np.int64]:
    """Return the order of rows that makes the wavelengths rise."""
    if len(nm) < 2:
        raise InputError.of("file", shown(path), "has one row of numbers; a spectrum needs two or more", "Add rows.")
    if not converted and written.min() > 0 and written.max() < _SURELY_UM:
        raise InputError.of(
            f"{path.name}: wavelengths",
            f"{written.min():g} to {written.max():g}",
            "look like micrometres, livlab takes nm",
            'If they are, add --wavelength-unit um (in Python: wavelength_unit="um").',
        )
    wrong = ~((nm >= SHORTEST_NM) & (nm <= LONGEST_NM))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError.of(
            f"{path.name}: line {lines[row]}, wavelength",
            float(written[row]),
            f"must be {SHORTEST_NM:g} to {LONGEST_NM:g} nm",
            "Correct the wavelength, or say --wavelength-unit um if it is in micrometres.",
        )
    order = np.argsort(nm, kind="stable")
    same = np.flatnonzero(np.diff(nm[order]) == 0)
    if len(same):
        first, second = sorted(int(lines[order[same[0] + i]]) for i in (0, 1))
        raise InputError.of(
            f"{path.name}: lines {first} and {second}, wavelength",
            float(written[order[same[0]]]),
            "is given twice",
            "Keep one row for each wavelength, or average them.",
        )
    if not sort and not np.array_equal(order, np.arange(len(nm))):
        row = int(np.argmax(np.diff(nm) < 0)) + 1
        raise InputError.of(
            f"{path.name}: line {lines[row]}, wavelength",
            float(written[row]),
            f"comes after {written[row - 1]:g}: wavelengths must rise",
            "Sort the file, or add --sort (in Python: sort=True).",
        )
    return order


def _check_values(path: Path, name: str, unit: str | None, values: FloatArray, lines: NDArray[np.int64] | None) -> None:
    coefficient = unit in {"1/mm", "1/cm", "1/m", "1/(cm M)", "1/(mm M)"}
    if (coefficient or _NOT_NEGATIVE.search(name.lower())) and values.min() < 0:
        row = int(np.argmax(values < 0))
        where = f"line {lines[row]}" if lines is not None else f"row {row + 1}"
        raise InputError.of(
            f"{path.name}: {where}, column {name}",
            float(values[row]),
            "must not be negative",
            "Correct the value (a baseline error?) or rename the column if it is another quantity.",
        )
    if unit == "1" and _RATIO.search(name.lower()) and values.max() > 1.5:
        raise InputError.of(
            f"{path.name}: column {name}",
            float(values.max()),
            "is above 1 for a ratio; it looks like percent",
            f'Give the unit: --column {name}:% (in Python: unit="%").',
        )


def _names(
    raw: RawTable, order: list[int], columns: Sequence[str], unit: str | None
) -> tuple[list[str], dict[str, str | None]]:
    default = None if unit is None else require_unit(unit)
    units: dict[str, str | None] = {}
    if columns:
        if len(columns) != len(order):
            raise InputError.of(
                "--column",
                list(columns),
                f"must name {len(order)} column(s) after the wavelength",
                "Give one per column.",
            )
        pairs = [text.partition(":") for text in columns]
        named = [(name.strip(), require_unit(u, field=f"unit of {name}") if sep else None) for name, sep, u in pairs]
    elif raw.headings is not None:
        named = [(_slug(raw.headings[i]), raw.units[i] or _unit_in_name(_slug(raw.headings[i]))) for i in order]
    else:
        raise InputError.of(
            "heading",
            None,
            f"is missing: {len(order)} column(s) beside the wavelength have no name",
            'Name them: --column NAME:UNIT, once per column (in Python: columns=["reflectance:1"]).',
        )
    for name, own in named:
        if not re.fullmatch(COLUMN_PATTERN, name) or name == WAVELENGTH:
            raise InputError.of(
                "column name",
                name,
                "must be a letter, then up to 63 letters, digits or _",
                "Name it: --column NAME:UNIT",
            )
        if name in units:
            raise InputError.of("column name", name, "is used twice", "Name the columns: --column NAME:UNIT")
        units[name] = own or default
    return [name for name, _ in named], units


def _slug(heading: str) -> str:
    bare = re.sub(r"\s*[\[(].*$", "", heading) or heading
    ascii_only = bare.replace("λ", "lambda").replace("µ", "u").replace("μ", "u")
    slug = re.sub(r"[^A-Za-z0-9]+", "_", ascii_only).strip("_")
    return slug if slug in {"n", "k"} or "_per_" in slug else slug.lower()


def _unit_in_name(name: str) -> str | None:
    match = re.search(r"_per_(cm|mm|m)$", name)
    return f"1/{match.group(1)}" if match else None
