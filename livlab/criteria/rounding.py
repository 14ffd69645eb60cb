"""Numbers as they are printed: with no more digits than their standard error supports."""

from __future__ import annotations

import math
from decimal import ROUND_HALF_EVEN, Decimal


def round_to_error(value: float, standard_error: float, digits: int = 2) -> float:
    """Value rounded to the place of the second significant digit of its standard error (JCGM 100:2008, 7.2.6).

    A standard error of 0 marks an exact number, which is left alone.

    Parameters
    ----------
    value, standard_error
        The number and its error.
    digits
        Significant digits of the error whose last place is kept.

    Examples
    --------
    >>> round_to_error(0.987654, 0.00123)
    0.9877
    >>> round_to_error(0.987654, 0.0)
    0.987654
    """
    if not (math.isfinite(value) and math.isfinite(standard_error) and standard_error > 0):
        return value
    return float(_quantised(value, _last_place(standard_error, digits)))


def format_value(value: float | None, standard_error: float | None = None) -> str:
    """Value with no more digits than its standard error supports: two digits of the error.

    Parameters
    ----------
    value
        The number; None or NaN gives "–".
    standard_error
        Its standard error; None, 0 or NaN marks a number without one, shown with six significant digits.

    Examples
    --------
    >>> format_value(0.987654, 0.00123), format_value(9.8312e-6, 2.5e-8), format_value(1 / 3)
    ('0.9877', '9.831e-6', '0.333333')
    """
    if value is None or math.isnan(value):
        return "–"
    if standard_error is None or not (math.isfinite(standard_error) and standard_error > 0) or math.isinf(value):
        return f"{value:.6g}"
    place = _last_place(standard_error)
    rounded = _quantised(value, place)
    if rounded != 0 and abs(rounded) < Decimal("1e-4") and place < -5:
        return f"{rounded:.{rounded.adjusted() - place}e}"
    return f"{rounded:.{max(0, -place)}f}"


def format_with_error(value: float | None, standard_error: float | None) -> str:
    """Value ± standard error, both to the same decimal place.

    >>> format_with_error(0.987654, 0.00123)
    '0.9877 ± 0.0012'
    """
    shown = format_value(value, standard_error)
    if value is None or standard_error is None or not (math.isfinite(standard_error) and standard_error > 0):
        return shown
    return f"{shown} ± {format_value(standard_error, standard_error)}"


def _last_place(standard_error: float, digits: int = 2) -> int:
    error = Decimal(repr(standard_error))
    # 0.0996 rounds to 0.10 and not to 0.100: the place is that of the rounded error.
    return Decimal(f"{error:.{digits - 1}e}").adjusted() - (digits - 1)


def _quantised(value: float, place: int) -> Decimal:
    number = Decimal(repr(value))
    if number.adjusted() - place > 25:
        return number
    return number.quantize(Decimal(1).scaleb(place), rounding=ROUND_HALF_EVEN)
