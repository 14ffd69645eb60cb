"""Where a spectrum comes from: a CSV, a dataset, or whatever a notebook holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from livlab.api.curve import Spectrum
from livlab.errors import InputError

_ERROR = "standard_error"


def as_spectrum(given: Any, name: str = "spectrum") -> Spectrum:
    """Whatever holds a spectrum as a `Spectrum`: a pair (wavelengths, values), pandas, colour-science, a CSV's path.

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
        return read_spectrum(given)
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


def read_spectrum(
    path: Path | str, column: str | None = None, *, unit: str | None = None, name: str | None = None
) -> Spectrum:
    """A spectrum from a CSV of any usual form: delimiter, decimal comma, heading or none, µm or nm, % or ratio.

    Parameters
    ----------
    path
        The file.
    column
        Column of the values; the first after the wavelength if not said. A column `standard_error` beside it is taken.
    unit
        Unit of a column that names none, "%" for one.
    name
        What plots call it; the file's name if not said.

    Raises
    ------
    InputError
        A file that is no table of numbers: line and column are named.
    """
    from livlab.datasets.draft import read_draft
    from livlab.datasets.meta import WAVELENGTH
    from livlab.datasets.quantity import convert_factor

    draft = read_draft(path, unit=unit)
    values = [n for n in draft.columns if n != WAVELENGTH]
    chosen = column or values[0]
    if chosen not in values:
        raise InputError.of("column", chosen, f"{Path(path).name} has {', '.join(values)}", "Name one of them.")
    own = draft.units.get(chosen)
    factor = convert_factor(own, "1", where=f"{Path(path).name}, column {chosen}") if own == "%" else 1.0
    error = draft.columns[_ERROR] * factor if _ERROR in values and chosen != _ERROR else None
    made = Spectrum.of(draft.columns[WAVELENGTH], draft.columns[chosen] * factor, error, name=name or Path(path).stem)
    taken = f"column {chosen}: " + ("no unit, taken as it is" if own is None else f"unit {own}")
    return replace(made, notes=(*draft.understood, taken))


def reference(
    dataset: str,
    column: str = "reflectance",
    *,
    sd_column: str | None = None,
    subjects: int = 1,
    name: str | None = None,
) -> Spectrum:
    """A measured curve of the catalogue.

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
    error = None if sd_column is None else table.column(sd_column) / np.sqrt(subjects)
    made = Spectrum.of(table.wavelength_nm, table.column(column), error, name=name or dataset)
    return replace(made, notes=(table.cite(),))
