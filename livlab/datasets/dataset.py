"""A table with its meta: columns, units, interpolation inside the range, citation and provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from livlab.datasets.meta import WAVELENGTH, DatasetMeta
from livlab.datasets.quantity import convert_factor
from livlab.errors import DatasetError, InputError, RangeError
from livlab.units import FloatArray

if TYPE_CHECKING:
    import pandas as pd

# A wavelength that went through a unit conversion may miss the end of the range by rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Dataset:
    """One table of the catalogue. `load` makes it; its arrays are read-only.

    Attributes
    ----------
    meta
        The content of ``meta.toml``.
    path
        The folder that holds ``table.csv`` and ``meta.toml``.
    columns
        Column name to its values: float64 arrays, or tuples of text.
    """

    meta: DatasetMeta
    path: Path
    columns: Mapping[str, FloatArray | tuple[str, ...]]

    def __repr__(self) -> str:
        return f"Dataset({self.name!r}, {len(self)} rows, {', '.join(self.columns)})"

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    @property
    def name(self) -> str:
        """Name in the catalogue."""
        return self.meta.name

    @property
    def is_spectrum(self) -> bool:
        """Whether the table has a wavelength axis."""
        return WAVELENGTH in self.columns

    @property
    def wavelength_nm(self) -> FloatArray:
        """Wavelengths, nm, rising.

        Raises
        ------
        DatasetError
            If the table is one of parameters.
        """
        if not self.is_spectrum:
            raise DatasetError(
                f"Dataset {self.name} has no wavelengths: it is a table of parameters.",
                remedy=f"Use its columns: {', '.join(self.columns)}.",
            )
        return self.column(WAVELENGTH)

    @property
    def range_nm(self) -> tuple[float, float]:
        """First and last wavelength, nm."""
        wavelength = self.wavelength_nm
        return float(wavelength[0]), float(wavelength[-1])

    @property
    def value_columns(self) -> tuple[str, ...]:
        """Names of the numeric columns beside the wavelength."""
        return tuple(n for n, c in self.meta.columns.items() if c.type == "number" and n != WAVELENGTH)

    @property
    def table(self) -> pd.DataFrame:
        """The table as a new `pandas.DataFrame`, columns as in ``table.csv``."""
        import pandas as pd

        return pd.DataFrame({n: np.array(v) if isinstance(v, np.ndarray) else list(v) for n, v in self.columns.items()})

    def to_frame(self) -> pd.DataFrame:
        """Return the table with the wavelength, where there is one, as index; ``attrs`` hold units and provenance."""
        frame = self.table
        if self.is_spectrum:
            frame = frame.set_index(WAVELENGTH)
        frame.attrs["units"] = {n: c.unit for n, c in self.meta.columns.items()}
        for key, text in self.provenance().items():
            frame.attrs[key] = text
        return frame

    def resolve(self, column: str) -> str:
        """Return the name in the table of a column or of one of its aliases.

        Raises
        ------
        DatasetError
            If there is no such column.
        """
        for name, column_meta in self.meta.columns.items():
            if column == name or column in column_meta.aliases:
                return name
        raise DatasetError(
            f"Dataset {self.name} has no column {column!r}.", remedy=f"It has: {', '.join(self.meta.columns)}."
        )

    def column(self, column: str) -> FloatArray:
        """Values of a numeric column (read-only).

        Raises
        ------
        DatasetError
            If there is no such column or it holds text.
        """
        name = self.resolve(column)
        values = self.columns[name]
        if not isinstance(values, np.ndarray):
            raise DatasetError(
                f"Column {name} of dataset {self.name} holds text.",
                remedy=f"Numeric columns are: {', '.join(self.value_columns)}.",
            )
        return values

    def unit(self, column: str) -> str:
        """Unit of a column; ``1`` for a ratio."""
        return self.meta.columns[self.resolve(column)].unit

    def interpolate(self, column: str, wavelength_nm: ArrayLike, *, unit: str | None = None) -> FloatArray:
        """Interpolate a column linearly between its tabulated points, inside the range only.

        Parameters
        ----------
        column
            Name or alias of a numeric column.
        wavelength_nm
            Wavelengths, nm, of any shape.
        unit
            Unit of the result, for example ``1/mm``; that of the table if absent.

        Returns
        -------
        FloatArray
            Values of the same shape as `wavelength_nm`.

        Raises
        ------
        RangeError
            If a wavelength is outside the table's range or is not a number.
        DatasetError
            If there is no such column, or the table has no wavelengths.
        InputError
            If the column cannot be converted to `unit`.

        Examples
        --------
        >>> from livlab.datasets import load
        >>> water = load("water_hale_querry1973")
        >>> round(float(water.interpolate("absorption_per_cm", 700.0, unit="1/mm")), 6)
        0.0006
        """
        values = self.column(column)
        try:
            asked = np.asarray(wavelength_nm, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError.of("wavelength_nm", wavelength_nm, "must be numbers", "Give wavelengths in nm.") from error
        first, last = self.range_nm
        outside = ~((asked >= first * (1 - _ROUNDING)) & (asked <= last * (1 + _ROUNDING)))
        if outside.any():
            worst = float(np.atleast_1d(asked)[np.atleast_1d(outside)][0])
            raise RangeError(
                f"Dataset {self.name} covers {first:g} to {last:g} nm, but {worst:g} nm was asked "
                f"(column {self.resolve(column)}).",
                remedy=f"Ask for wavelengths from {first:g} to {last:g} nm, or use a dataset that covers {worst:g} nm; "
                "livlab does not extrapolate.",
            )
        result = np.asarray(np.interp(asked, self.wavelength_nm, values), dtype=np.float64)
        return (
            result if unit is None else result * convert_factor(self.unit(column), unit, where=f"{self.name}.{column}")
        )

    def cite(self) -> str:
        """Citation in one line: source, DOI, and how the numbers came."""
        doi = f" doi:{self.meta.doi}." if self.meta.doi else ""
        return (
            f"{self.meta.source.rstrip('.')}.{doi} [{self.meta.kind}; dataset {self.name}, version {self.meta.version}]"
        )

    def bibtex(self) -> dict[str, str]:
        """Fields of a BibTeX entry (``ENTRYTYPE``, ``ID`` and those that are known)."""
        fields = {
            "ENTRYTYPE": "misc",
            "ID": self.name,
            "title": self.meta.title,
            "howpublished": self.meta.source,
            "year": "" if self.meta.year is None else str(self.meta.year),
            "doi": self.meta.doi or "",
            "url": self.meta.url or "",
            "note": f"{self.meta.kind}; {self.meta.uncertainty.text}",
        }
        return {key: value for key, value in fields.items() if value}

    def provenance(self) -> dict[str, str]:
        """Where the numbers came from, as every report prints it."""
        meta = self.meta
        return {
            "name": self.name,
            "source": meta.source,
            "doi": meta.doi or "",
            "kind": meta.kind,
            "uncertainty": meta.uncertainty.text,
            "licence": meta.licence,
            "sha256": meta.sha256,
        }
