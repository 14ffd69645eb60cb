"""Where a spectrum comes from: a CSV, a dataset, or whatever a notebook holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from livlab.api.arguments import explained
from livlab.api.curve import Spectrum
from livlab.errors import InputError

_ERROR = "standard_error"

PERCENT = 1.5
"""A ratio above this looks like percent; a little above 1 may be noise, or a tile brighter than the standard."""


def as_spectrum(given: Any, name: str = "spectrum") -> Spectrum:
    """Whatever holds a spectrum as a `Spectrum`.

    A pair (wavelengths, values), an array of two columns, {wavelength: value}, pandas, colour-science, a CSV's path.

    Raises
    ------
    InputError
        Something else.

    Examples
    --------
    >>> as_spectrum(([500, 600], [0.1, 0.2]))
    <Spectrum 'spectrum': 2 wavelengths, 500–600 nm, 0.1 to 0.2>
    """
    if isinstance(given, Spectrum):
        return given
    if isinstance(given, (str, Path)):
        _no_dataset(given)
        return read_spectrum(given)
    if isinstance(given, Mapping) and given:
        return Spectrum.of(list(given), list(given.values()), name=name)
    if isinstance(given, np.ndarray) and given.ndim == 2 and 2 in given.shape and given.shape != (2, 2):
        return Spectrum.of(*(given if given.shape[0] == 2 else given.T), name=name)
    if hasattr(given, "index") and hasattr(given, "to_numpy"):
        return Spectrum.from_pandas(given)
    if hasattr(given, "wavelengths") and hasattr(given, "values"):
        return Spectrum.from_colour(given)
    if isinstance(given, (tuple, list)) and len(given) in (2, 3):
        return Spectrum.of(*given, name=name)
    raise InputError.of(
        name,
        type(given).__name__,
        "is no spectrum",
        "Give a Spectrum, (wavelengths, values), a pandas Series, a SpectralDistribution or a CSV's path.",
    )


def _no_dataset(given: str | Path) -> None:
    """Say what was meant where a dataset's name is given as if it were a file."""
    from livlab import datasets

    if isinstance(given, str) and not Path(given).suffix and not Path(given).exists() and given in datasets.names():
        columns = datasets.load(given).value_columns
        raise InputError.of(
            "file", given, "does not exist, but is the name of a dataset",
            f"Say livlab.reference({given!r}, COLUMN) with one of {', '.join(columns)}.",
        )  # fmt: skip


@explained
def read_spectrum(
    path: Path | str,
    column: str | None = None,
    *,
    unit: str | None = None,
    sd_column: str | None = None,
    subjects: int = 1,
    wavelength_unit: str | None = None,
    sort: bool = False,
    name: str | None = None,
) -> Spectrum:
    """A spectrum from a CSV of any usual form: delimiter, decimal comma, heading or none, µm or nm, % or ratio.

    Parameters
    ----------
    path
        The file.
    column
        Column of the values; the first after the wavelength that is no standard deviation if not said. A column
        `standard_error` beside it is taken.
    unit
        Unit of a column that names none, "%" for one.
    sd_column, subjects
        Column of the standard deviation and the number of subjects behind the mean: the error is SD/√subjects.
    wavelength_unit
        "nm" or "um", where the heading does not say it.
    sort
        Sort rows that are in no order of wavelength.
    name
        What plots call it; the file's name if not said.

    Raises
    ------
    InputError
        A file that is no table of numbers: line and column are named. An absorbance, unless its column is named.
    """
    from livlab.datasets.draft import read_draft
    from livlab.datasets.meta import WAVELENGTH
    from livlab.datasets.quantity import convert_factor, is_absorbance, is_spread

    if isinstance(subjects, bool) or not isinstance(subjects, int) or subjects < 1:
        raise InputError.of("subjects", subjects, "must be a whole number, 1 or more", "Give those behind the mean.")
    file = Path(path).name
    draft = read_draft(path, unit=unit, wavelength_unit=wavelength_unit, sort=sort, nameless=True)
    values = [n for n in draft.columns if n != WAVELENGTH]
    chosen = column or next((n for n in values if not is_spread(n)), values[0])
    for asked in (chosen, sd_column):
        if asked is not None and asked not in values:
            raise InputError.of("column", asked, f"{file} has {', '.join(values)}", "Name one of them.")
    own, given = draft.units.get(chosen), draft.columns[chosen]
    top = float(given.max())
    if column is None and is_absorbance(chosen):
        raise InputError.of(
            f"{file}: column", chosen, "is an absorbance, and reflectance is wanted",
            f"Convert it: R = 10**(-A), if A = -log10 R; or name it, column={chosen!r}, if it is something else.",
        )  # fmt: skip
    if own is None and top > PERCENT and "refle" in chosen:
        raise InputError.of(
            f"{file}: column {chosen}", top, "is above 1 for a reflectance without a unit; it looks like percent",
            'Say unit="%", or write the unit into the heading: Reflectance (%).',
        )  # fmt: skip

    def ratio(of: str) -> float:
        """Factor that makes a ratio of percent; the spread of a column without a unit has that column's."""
        unit = draft.units.get(of) or own
        return convert_factor(unit, "1", where=f"{file}, column {of}") if unit == "%" else 1.0

    error = None
    if sd_column is not None:
        error = draft.columns[sd_column] * ratio(sd_column) / np.sqrt(subjects)
    elif _ERROR in values and chosen != _ERROR:
        error = draft.columns[_ERROR] * ratio(_ERROR)
    said = [f"column {chosen}: " + ("no unit, taken as it is" if own is None else f"unit {own}")]
    if own is None and top > PERCENT:
        said.append(f'values reach {top:.4g}: a reflectance is at most 1; say unit="%" if they are percent')
    left = [n for n in values if n not in (chosen, sd_column, _ERROR)]
    said += [f"columns not used: {', '.join(left)}"] if left else []
    if sd_column is None and (spread := next(filter(is_spread, left), None)):
        said.append(f"for the error, name the standard deviation and the subjects: sd_column={spread!r}, subjects=…")
    made = Spectrum.of(draft.columns[WAVELENGTH], given * ratio(chosen), error, name=name or Path(path).stem)
    return replace(made, notes=(*draft.understood, *said))


@explained
def reference(
    dataset: str,
    column: str = "reflectance",
    *,
    sd_column: str | None = None,
    subjects: int = 1,
    name: str | None = None,
) -> Spectrum:
    """A measured curve of the catalogue; percent becomes a ratio.

    Parameters
    ----------
    dataset, column
        As `livlab data list` and `livlab data show` name them.
    sd_column, subjects
        Column of the standard deviation and the subjects behind the mean: the error is SD/√subjects.
    name
        What plots call it; the dataset's name if not said.

    Raises
    ------
    DatasetError
        An unknown or damaged dataset or column; `ReferenceUnavailable` where nobody has the numbers.

    Examples
    --------
    >>> reference("liver_hsi_sellner2026", "human_reflectance_share", name="human liver")
    <Spectrum 'human liver': 100 wavelengths, 500–1000 nm, 0.001858 to 0.01411>
    """
    from livlab import datasets

    if subjects < 1:
        raise InputError.of("subjects", subjects, "must be at least 1", "Give the number behind the mean.")
    table = datasets.load(dataset)

    def ratio(of: str) -> float:
        return 0.01 if table.unit(of) == "%" else 1.0

    error = None if sd_column is None else table.column(sd_column) * ratio(sd_column) / np.sqrt(subjects)
    made = Spectrum.of(table.wavelength_nm, table.column(column) * ratio(column), error, name=name or dataset)
    return replace(made, notes=(table.cite(),))
