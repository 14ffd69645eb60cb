"""Which column of a pandas frame or series is the wavelength, which the curve, and which its error."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.datasets.heading import units_of
from livlab.datasets.quantity import is_spread
from livlab.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

_WAVELENGTH = re.compile(r"^\s*(wave_?length|lambda|λ|wl\b|wellenl|nm\b)", re.IGNORECASE)
_ERROR = "standard_error"


def curve_of(given: pd.Series | pd.DataFrame) -> tuple[Any, Any, Any, str]:
    """Wavelengths in nm, values, standard errors or None, and a name.

    Of a frame the wavelengths are the column called so, else the index; the curve is `value`, else the only column
    that is left beside standard deviations. A heading in percent is taken at its word.

    Raises
    ------
    InputError
        An index that only counts rows, or more than one column that could be the curve.
    """
    if not hasattr(given, "columns"):
        return _index(given), _scaled(given, str(given.name or "")), None, str(given.name or "spectrum")
    axis = next((c for c in given.columns if _WAVELENGTH.match(str(c))), None)
    names = [c for c in given.columns if c is not axis and c != _ERROR and not is_spread(_slug(c))]
    chosen = "value" if "value" in names else names[0] if len(names) == 1 else None
    if chosen is None:
        raise InputError.of(
            "columns", [str(c) for c in given.columns], "holds more than one curve, or none",
            "Pick one: frame.set_index(WAVELENGTH)[COLUMN], or call it 'value'.",
        )  # fmt: skip
    grid = given[axis] if axis is not None else _index(given)
    value = _scaled(given[chosen], str(chosen))
    error = given[_ERROR] if _ERROR in given.columns else None
    return grid, value, error, "spectrum" if chosen == "value" else str(chosen)


def _slug(heading: object) -> str:
    return re.sub(r"[^a-z0-9]+", "_", str(heading).lower()).strip("_")


def _scaled(values: Any, heading: str) -> Any:
    return values / 100 if units_of([heading])[0] == "%" else values


def _index(given: Any) -> Any:
    index = given.index
    if len(index) > 1 and index.dtype.kind in "iu" and np.array_equal(index, np.arange(len(index))):
        raise InputError.of(
            "index", f"0 to {len(index) - 1}", "counts the rows and is no wavelength in nm",
            "Set it: frame.set_index(WAVELENGTH)[COLUMN], or give (wavelengths, values).",
        )  # fmt: skip
    return index


__all__ = ["curve_of"]
