"""Units that a column may be in, how people spell them, and factors between them."""

from __future__ import annotations

import difflib
import math
import re

from livlab.errors import InputError

# unit -> (dimension, size in the dimension's first unit)
_UNITS: dict[str, tuple[str, float]] = {
    "1": ("ratio", 1.0),
    "%": ("ratio", 0.01),
    "1/mm": ("coefficient", 1.0),
    "1/cm": ("coefficient", 0.1),
    "1/m": ("coefficient", 1e-3),
    "mm": ("length", 1.0),
    "cm": ("length", 10.0),
    "m": ("length", 1e3),
    "um": ("length", 1e-3),
    "nm": ("length", 1e-6),
    "1/(cm M)": ("molar extinction", 1.0),
    "1/(mm M)": ("molar extinction", 10.0),
    "1/sr": ("per solid angle", 1.0),
    "rad": ("angle", 1.0),
    "deg": ("angle", math.pi / 180),
    "M": ("concentration", 1.0),
    "mmol/L": ("concentration", 1e-3),
}
_SPELLINGS = {
    "": "1",
    "-": "1",
    "none": "1",
    "dimensionless": "1",
    "ratio": "1",
    "a.u.": "1",
    "au": "1",
    "percent": "%",
    "cm-1": "1/cm",
    "cm^-1": "1/cm",
    "cm⁻¹": "1/cm",
    "mm-1": "1/mm",
    "mm^-1": "1/mm",
    "mm⁻¹": "1/mm",
    "m-1": "1/m",
    "m^-1": "1/m",
    "m⁻¹": "1/m",
    "µm": "um",
    "μm": "um",
    "micron": "um",
    "microns": "um",
    "cm-1/m": "1/(cm M)",
    "cm-1 m-1": "1/(cm M)",
    "1/cm/m": "1/(cm M)",
    "l/(mol cm)": "1/(cm M)",
    "sr-1": "1/sr",
    "sr^-1": "1/sr",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "radian": "rad",
    "mm/l": "mmol/L",
}
_ABSORBANCE = re.compile(r"(^|_)(abs|absorban[a-z]*|od|optical_density|extinktion|log_1_r|log1_r)(_|$)")
_SPREAD = re.compile(r"(^|_)(sd|std|stdev|stddev|stabw|standard_deviation|se|sem|standard_error|err|error)(_|$)")


def is_absorbance(column: str) -> bool:
    """Whether a column's name says that it holds an absorbance, which no reflectance is to be compared with.

    >>> is_absorbance("od"), is_absorbance("absorbance_mean"), is_absorbance("absorption_per_cm")
    (True, True, False)
    """
    return _ABSORBANCE.search(column) is not None


def is_spread(column: str) -> bool:
    """Whether a column's name says that it holds the spread of another.

    >>> is_spread("r_std"), is_spread("sd"), is_spread("used")
    (True, True, False)
    """
    return _SPREAD.search(column) is not None


def known_units() -> tuple[str, ...]:
    """Every unit livlab knows."""
    return tuple(_UNITS)


def parse_unit(text: str) -> str | None:
    """Return livlab's spelling of a unit, or None if it is not one that livlab knows.

    >>> parse_unit("cm-1"), parse_unit("%"), parse_unit("furlong")
    ('1/cm', '%', None)
    """
    stripped = text.strip()
    if stripped in _UNITS:
        return stripped
    return _SPELLINGS.get(stripped.lower()) or next((u for u in _UNITS if u.lower() == stripped.lower() != "m"), None)


def require_unit(text: str, *, field: str = "unit") -> str:
    """Return livlab's spelling of a unit.

    Raises
    ------
    InputError
        If livlab does not know it; near misses and the whole list are named.
    """
    unit = parse_unit(text)
    if unit is None:
        near = difflib.get_close_matches(text, [*_UNITS, *_SPELLINGS], n=2)
        hint = f"Did you mean {' or '.join(near)}? " if near else ""
        raise InputError.of(field, text, "is not a unit livlab knows", f"{hint}Known: {', '.join(_UNITS)}.")
    return unit


def convert_factor(source: str, target: str, *, where: str = "unit") -> float:
    """Factor that takes numbers in `source` to numbers in `target`.

    >>> convert_factor("1/cm", "1/mm")
    0.1

    Raises
    ------
    InputError
        If the two do not measure the same thing.
    """
    if source == target:
        return 1.0
    wanted = require_unit(target)
    have = parse_unit(source)
    if have is None or _UNITS[have][0] != _UNITS[wanted][0]:
        dimension = "an unknown quantity" if have is None else _UNITS[have][0]
        raise InputError.of(
            where,
            source,
            f"is {dimension} and cannot be given in {target}",
            "Ask for a unit of the same kind, or choose another column.",
        )
    return _UNITS[have][1] / _UNITS[wanted][1]
