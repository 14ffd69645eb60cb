"""A claim as an object: a number with its error, held against a reference, and the verdict that follows.

What is written is what was judged: a value is first rounded to the digits its standard error supports.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Decimal
from pathlib import Path
from typing import Literal

from livlab.core.files import first_line, readable
from livlab.errors import InputError

LARGEST_BYTES = 1 << 26
"""Of a table of claims."""

Verdict = Literal["PASS", "FAIL", "MISSING"]

COLUMNS = ("criterion", "value", "standard_error", "reference", "tolerance", "verdict", "seconds")
"""Columns of claims.csv, in order."""

BOUNDS: dict[str, tuple[float, float]] = {
    "pearson": (-1.0, 1.0),
    "rmse": (0.0, math.inf),
    "mse": (0.0, math.inf),
    "amplitude ratio": (0.0, math.inf),
    "colour difference": (0.0, math.inf),
}
"""Where a metric's value can lie at all."""


def round_to_error(value: float, standard_error: float) -> float:
    """Value rounded to the place of the second significant digit of its standard error (JCGM 100:2008, 7.2.6).

    A standard error of 0 marks an exact number, which is left alone.

    >>> round_to_error(0.987654, 0.00123)
    0.9877
    >>> round_to_error(0.987654, 0.0)
    0.987654
    """
    if not (math.isfinite(value) and math.isfinite(standard_error) and standard_error > 0):
        return value
    return float(_quantised(value, _last_place(standard_error)))


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


@dataclass(frozen=True)
class Claim:
    """One line of claims.csv.

    Attributes
    ----------
    criterion
        Its name: metric, reading and reference ("pearson measured vs human liver 500-720").
    value, standard_error
        The number found and its standard error (0 for an exact number); None where it is MISSING.
    reference, tolerance
        What it is held against: PASS if |value − reference| ≤ tolerance.
    verdict
        PASS, FAIL (also where the standard error exceeds half the tolerance), or MISSING.
    seconds
        What it cost.
    note
        Why it failed for want of power, or why it is missing; kept beside the CSV, not in it.
    """

    criterion: str
    value: float | None
    standard_error: float | None
    reference: float | None
    tolerance: float | None
    verdict: Verdict
    seconds: float = 0.0
    note: str = ""

    def __post_init__(self) -> None:
        if not self.criterion.strip() or any(c in self.criterion for c in "\r\n\0"):
            raise InputError.of("criterion", self.criterion, "must be one line of text", "Name the criterion.")
        if not (math.isfinite(self.seconds) and self.seconds >= 0):
            raise InputError.of(f"{self.criterion}: seconds", self.seconds, "must be finite and ≥ 0", "Mend it.")
        if self.verdict == "MISSING":
            return
        expected, _ = _judge(self.criterion, self.value, self.standard_error, self.reference, self.tolerance)
        if self.verdict != expected:
            raise InputError.of(
                f"{self.criterion}: verdict", self.verdict, f"the numbers say {expected}", "Use Claim.of, which judges."
            )

    @classmethod
    def of(
        cls,
        criterion: str,
        value: float,
        standard_error: float,
        reference: float,
        tolerance: float,
        *,
        seconds: float = 0.0,
    ) -> Claim:
        """Round to what the standard error supports, then judge.

        >>> Claim.of("pearson", 0.99512, 0.0004, 1.0, 0.01).verdict
        'PASS'
        >>> Claim.of("pearson", 0.99512, 0.02, 1.0, 0.01).note
        'underpowered: standard error 0.02 exceeds half the tolerance 0.01'
        """
        if math.isfinite(standard_error) and math.isfinite(value):
            value = round_to_error(float(value), float(standard_error))
            standard_error = round_to_error(float(standard_error), float(standard_error))
        verdict, note = _judge(criterion, value, standard_error, reference, tolerance)
        return cls(criterion, value, standard_error, reference, tolerance, verdict, float(seconds), note)

    @classmethod
    def missing(
        cls,
        criterion: str,
        reason: str,
        *,
        reference: float | None = None,
        tolerance: float | None = None,
        seconds: float = 0.0,
    ) -> Claim:
        """A claim that cannot be judged, with the reason.

        >>> Claim.missing("pearson thesis vs Nachabé 2011", "reference not available").verdict
        'MISSING'
        """
        if not reason.strip():
            raise InputError.of(f"{criterion}: reason", reason, "a missing claim must say why", "Give the reason.")
        return cls(criterion, None, None, reference, tolerance, "MISSING", seconds, reason)


@dataclass(frozen=True)
class Criterion:
    """What is to be judged: a metric of one reading against one reference over a band.

    Attributes
    ----------
    metric
        "pearson", "rmse", "mse", "amplitude ratio", "colour difference", or another name.
    reading
        The reading or model judged.
    against
        The reference as people call it ("human liver").
    reference, tolerance
        PASS if |value − reference| ≤ tolerance (Pearson: 1 and 0.01; RMSE: 0 and 0.1).
    band_nm
        First and last wavelength, or None where it does not apply.
    bounds
        Where the value can lie at all; by default the metric's own (`BOUNDS`).

    Examples
    --------
    >>> Criterion("pearson", "measured", "human liver", 1.0, 0.01, band_nm=(500, 720)).name
    'pearson measured vs human liver 500-720'
    """

    metric: str
    reading: str
    against: str
    reference: float
    tolerance: float
    band_nm: tuple[float, float] | None = None
    bounds: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        """Metric, reading, reference and band in one line."""
        band = "" if self.band_nm is None else f" {self.band_nm[0]:g}-{self.band_nm[1]:g}"
        return f"{self.metric} {self.reading} vs {self.against}{band}"

    def judge(self, value: float, standard_error: float, *, seconds: float = 0.0) -> Claim:
        """The claim that a value makes.

        Raises
        ------
        InputError
            If the value is no number or lies where the metric cannot.
        """
        low, high = self.bounds or BOUNDS.get(self.metric, (-math.inf, math.inf))
        if not low <= value <= high:
            raise InputError.of(
                f"{self.name}: value", value, f"must lie within [{low:g}, {high:g}]", "The metric was not computed."
            )
        return Claim.of(self.name, value, standard_error, self.reference, self.tolerance, seconds=seconds)

    def missing(self, reason: str, *, seconds: float = 0.0) -> Claim:
        """The claim where the value or its reference is not available."""
        return Claim.missing(self.name, reason, reference=self.reference, tolerance=self.tolerance, seconds=seconds)


def write_claims(path: Path, claims: Iterable[Claim]) -> None:
    """Write claims.csv (exactly `COLUMNS`) and, beside it, NAME.notes.json with the notes by criterion.

    Raises
    ------
    InputError
        If two claims share a name: the notes could not be told apart.
    """
    rows = list(claims)
    names = [claim.criterion for claim in rows]
    for name in names:
        if names.count(name) > 1:
            raise InputError.of("criterion", name, "appears twice", "Name each claim by metric, reading and reference.")
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for c in rows:
            numbers = (c.value, c.standard_error, c.reference, c.tolerance)
            writer.writerow([c.criterion, *(_cell(x) for x in numbers), c.verdict, f"{c.seconds:.4g}"])
    notes = {c.criterion: c.note for c in rows if c.note}
    beside = _notes_path(path)
    if notes:
        beside.write_text(json.dumps(notes, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    else:
        beside.unlink(missing_ok=True)


def read_claims(path: Path) -> tuple[Claim, ...]:
    """Read what `write_claims` wrote; each verdict is held against its numbers.

    Raises
    ------
    InputError
        If the columns are not exactly `COLUMNS`, a cell is no number, or a verdict contradicts its numbers.
    """
    beside = _notes_path(path)
    notes: dict[str, str] = {}
    try:
        text = readable(path, "claims", LARGEST_BYTES).read_text(encoding="utf-8")
        if beside.exists():
            notes = json.loads(readable(beside, "claims", LARGEST_BYTES).read_text(encoding="utf-8"))
        if not isinstance(notes, dict):
            raise ValueError(f"{beside.name} is no table")
        rows = list(csv.reader(io.StringIO(text, newline="")))
    except InputError:
        raise
    except (ValueError, RecursionError, csv.Error) as error:
        raise InputError.of(str(path), first_line(error), "is no table of claims", "Write it anew.") from error
    header: Sequence[str] = rows[0] if rows else []
    if tuple(header) != COLUMNS:
        raise InputError.of(str(path), list(header), f"the columns must be {','.join(COLUMNS)}", "Write it anew.")
    claims = []
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(COLUMNS):
            raise InputError.of(f"{path}, line {line}", row, f"must have {len(COLUMNS)} cells", "Write it anew.")
        name, *cells, verdict, seconds = row
        if verdict not in ("PASS", "FAIL", "MISSING"):
            raise InputError.of(f"{path}, line {line}", verdict, "must be PASS, FAIL or MISSING", "Write it anew.")
        try:
            value, standard_error, reference, tolerance = (float(x) if x else None for x in cells)
            cost = float(seconds)
        except ValueError as error:
            raise InputError.of(f"{path}, line {line}", row, "holds a cell that is no number", "Mend it.") from error
        known: Verdict = verdict  # type: ignore[assignment]
        claims.append(Claim(name, value, standard_error, reference, tolerance, known, cost, str(notes.get(name, ""))))
    return tuple(claims)


def _judge(
    name: str, value: float | None, standard_error: float | None, reference: float | None, tolerance: float | None
) -> tuple[Verdict, str]:
    numbers = {"value": value, "standard_error": standard_error, "reference": reference, "tolerance": tolerance}
    for what, number in numbers.items():
        if number is None or not math.isfinite(number) or (number < 0 and what in ("standard_error", "tolerance")):
            bound = "must be a finite number" + (" ≥ 0" if what in ("standard_error", "tolerance") else "")
            raise InputError.of(f"{name}: {what}", number, bound, "Use Claim.missing where there is none.")
    assert value is not None and standard_error is not None and reference is not None and tolerance is not None
    # 1 − 0.99 is 0.010000000000000009 in binary: the bound itself must pass.
    slack = 1e-12 * max(abs(value), abs(reference), tolerance)
    if standard_error > tolerance / 2 + slack:
        return "FAIL", f"underpowered: standard error {standard_error:g} exceeds half the tolerance {tolerance:g}"
    return ("PASS" if abs(value - reference) <= tolerance + slack else "FAIL"), ""


def _last_place(standard_error: float) -> int:
    error = Decimal(repr(standard_error))
    # 0.0996 rounds to 0.10 and not to 0.100: the place is that of the rounded error.
    return Decimal(f"{error:.1e}").adjusted() - 1


def _quantised(value: float, place: int) -> Decimal:
    number = Decimal(repr(value))
    if number.adjusted() - place > 25:
        return number
    return number.quantize(Decimal(1).scaleb(place), rounding=ROUND_HALF_EVEN)


def _cell(number: float | None) -> str:
    return "" if number is None else repr(float(number))


def _notes_path(path: Path) -> Path:
    return path.with_suffix(".notes.json")
