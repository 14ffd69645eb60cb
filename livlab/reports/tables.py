"""Tables of the report: data frames turned into rows of text, numbers to the digits their error supports."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from livlab.criteria import GROUPS, VERDICTS, group_title
from livlab.criteria.judging import verdict_counts

NOT_AVAILABLE = "not available"
LONG_TEXT = 28
"""Characters beyond which a column of text gets room to wrap in."""


@dataclass(frozen=True)
class Column:
    """A column: its heading, and whether its cells are numbers."""

    title: str
    numeric: bool
    css: str


@dataclass(frozen=True)
class Row:
    """A row of text; `marked` rows are set apart."""

    cells: tuple[str, ...]
    marked: bool = False


@dataclass(frozen=True)
class Table:
    """A table as the page shows it; a `folded` one hides behind that summary line."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    folded: str = ""
    kind: str = "table"


@dataclass(frozen=True)
class ClaimTable:
    """A table of claims of one group, with its heading and the number of each verdict."""

    caption: str
    rows: tuple[Mapping[str, str], ...]
    title: str = ""
    counts: tuple[tuple[str, int], ...] = ()
    kind: str = "claims"


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = "text"


@dataclass(frozen=True)
class Code:
    """A block of code, folded where it is long."""

    text: str
    folded: str = ""
    kind: str = "code"


@dataclass(frozen=True)
class Records:
    """A list of things, each with a name and a few lines about it."""

    caption: str
    items: tuple[tuple[str, tuple[tuple[str, str], ...]], ...]
    kind: str = "records"


@dataclass(frozen=True)
class Picture:
    """An inline SVG (already safe markup) and its caption."""

    svg: Any
    caption: str
    kind: str = "figure"


@dataclass(frozen=True)
class Image:
    """A picture of pixels: its source (a data URI or a relative path), what a screen reader says, its caption."""

    source: str
    alt: str
    caption: str
    width: int
    height: int


@dataclass(frozen=True)
class Images:
    """Pictures side by side, as many in a row as there is room for; `large` ones have a row each."""

    items: tuple[Image, ...]
    caption: str = ""
    large: bool = False
    kind: str = "images"


@dataclass(frozen=True)
class ReportSection:
    """A section of the page."""

    id: str
    title: str
    content: list[Any] = field(default_factory=list)


def number(value: Any, digits: int = 4) -> str:
    """Text of a number, `not available` for a missing one; text passes through.

    >>> number(0.123456), number(float("nan")), number("ex vivo"), number(250000), number(1.2e-7)
    ('0.1235', 'not available', 'ex vivo', '250 000', '1.2e-7')
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NOT_AVAILABLE
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if float(value).is_integer() and abs(value) < 1e15:
        return f"{int(value):,}".replace(",", "\u202f" if abs(value) >= 10000 else "").replace("\u202f", " ")
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        return f"{mantissa}e{int(exponent)}"
    return text


def with_error(value: Any, error: Any) -> str:
    """Value ± standard error, with two digits of the error and no more digits of the value than it supports.

    >>> with_error(0.98765, 0.00123), with_error(0.5, 0.0), with_error(None, None), with_error(1234.5, 210.0)
    ('0.9877 ± 0.0012', '0.5', 'not available', '1230 ± 210')
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NOT_AVAILABLE
    if error is None or not math.isfinite(error) or error <= 0:
        return number(float(value))
    places = 1 - math.floor(math.log10(error))
    if places > 9:
        return f"{value:.6g} ± {error:.1e}"
    rounded = round(float(value), places)
    return f"{rounded:.{max(places, 0)}f} ± {round(float(error), places):.{max(places, 0)}f}"


def from_frame(
    frame: pd.DataFrame,
    caption: str,
    *,
    titles: Mapping[str, str] | None = None,
    only: Sequence[str] | None = None,
    marked: str = "",
    folded: str = "",
    short: Sequence[str] = (),
) -> Table:
    """Turn a frame into a table.

    Parameters
    ----------
    titles
        Headings for columns whose name is not one.
    only
        Columns to show, those that exist, in this order; all by default.
    marked
        Name of a truth-valued column that sets a row apart; not shown itself.
    folded
        Summary line behind which the table hides.
    short
        Columns cut to twelve characters (hashes).
    """
    names = [c for c in (only or list(frame.columns)) if c in frame.columns and c != marked]
    columns = []
    for name in names:
        numeric = bool(pd.api.types.is_numeric_dtype(frame[name]) and not pd.api.types.is_bool_dtype(frame[name]))
        numeric = numeric and bool(frame[name].notna().any() or not len(frame))  # nothing at all may be words
        long = not numeric and frame[name].astype(str).str.len().max() > LONG_TEXT
        css = "num" if numeric else ("hash" if name in short else ("long" if long else ""))
        columns.append(Column((titles or {}).get(name, name.replace("_", " ")), numeric, css))
    rows = []
    for record in frame.to_dict("records"):
        cells = tuple(
            "–" if not column.numeric and pd.isna(record[n]) else number(record[n])[: 12 if n in short else None]
            for n, column in zip(names, columns, strict=True)
        )
        rows.append(Row(cells, bool(marked) and str(record.get(marked)).lower() in {"true", "yes", "1"}))
    return Table(caption, tuple(columns), tuple(rows), folded)


def claim_rows(claims: pd.DataFrame, reasons: Mapping[str, str]) -> tuple[dict[str, str], ...]:
    """Rows of the claim table; a MISSING claim always says why."""
    rows = []
    for c in claims.to_dict("records"):
        verdict = str(c["verdict"])
        if verdict not in VERDICTS:
            verdict = "MISSING"
        name = str(c["criterion"])
        reason = reasons.get(name, "")
        digits = _digits(c)
        if verdict == "MISSING" and not reason:
            reason = "the run gave no reason"
        rows.append(
            {
                "criterion": name,
                "value": number(c["value"], digits)
                if pd.isna(c["standard_error"])
                else with_error(c["value"], c["standard_error"]),
                "wanted": wanted_words(c, digits),
                "group": str(c.get("group", "checks")),
                "verdict": verdict,
                "css": verdict.replace(" ", "-"),
                "seconds": number(c["seconds"], 3),
                "reason": reason,
            }
        )
    return tuple(rows)


def claim_tables(rows: Sequence[Mapping[str, str]], tissue: str, caption: str = "") -> tuple[ClaimTable, ...]:
    """The claims of a run by group: what the thesis prints, what was measured, livlab's own."""
    made = []
    for group in GROUPS:
        own = tuple(row for row in rows if row["group"] == group)
        if own:
            made.append(ClaimTable(caption or _ABOUT[group], own, group_title(group, tissue), verdict_counts(own)))
    other = tuple(row for row in rows if row["group"] not in GROUPS)
    return (*made, ClaimTable(caption, other, "Other claims", verdict_counts(other))) if other else tuple(made)


_ABOUT = {
    "reproduces": "Figures that the thesis prints, with a tolerance on both sides: a value that is better than the "
    "thesis's does not reproduce it.",
    "agrees": "Distance from what was measured, with a limit on one side: less error is never too little.",
    "checks": "Livlab held against itself, against other codes, and against margins of its own.",
}


def wanted_words(claim: Mapping[Any, Any], digits: int = 4) -> str:
    """What a claim wants: "at most 0.1", "0.19 ± 0.04", "15 to 60"."""
    low, high, reference, tolerance = (
        None if pd.isna(claim.get(k)) else claim.get(k) for k in ("at_least", "at_most", "reference", "tolerance")
    )
    if low is not None and high is not None:
        if reference is not None and tolerance is not None:
            return f"{number(reference, digits)} ± {number(tolerance)}"
        return f"{number(low, digits)} to {number(high, digits)}"
    if low is not None:
        return f"at least {number(low, digits)}"
    return NOT_AVAILABLE if high is None else f"at most {number(high, digits)}"


def _digits(claim: Mapping[Any, Any]) -> int:
    """Digits that show a number to a tenth of its tolerance, so that the reader can judge the verdict.

    >>> _digits({"reference": 0.5, "tolerance": 0.05}), _digits({"reference": 1.0, "tolerance": 2e-5}), _digits({})
    (4, 6, 4)
    """
    reference, tolerance = claim.get("reference"), claim.get("tolerance")
    if pd.isna(reference) or pd.isna(tolerance) or not reference or not tolerance > 0:
        return 4
    return min(max(4, math.ceil(math.log10(abs(reference) / tolerance)) + 1), 12)


def merge_readings(frame: pd.DataFrame) -> pd.DataFrame:
    """Join the rows that several readings share; `all` where every reading has the row."""
    if "reading" not in frame.columns or not len(frame):
        return frame
    every = list(dict.fromkeys(frame["reading"]))
    rest = [c for c in frame.columns if c != "reading"]
    joined = frame.groupby(rest, sort=False, dropna=False)["reading"].agg(list).reset_index()
    joined["reading"] = ["all" if len(r) == len(every) else ", ".join(r) for r in joined["reading"]]
    return joined[["reading", *rest]]


def records(frame: pd.DataFrame, caption: str, name: str) -> Records:
    """One record a row, named by a column; empty fields are left out."""
    items = []
    for row in frame.to_dict("records"):
        lines = tuple((str(k).replace("_", " "), number(v)) for k, v in row.items() if k != name and not pd.isna(v))
        items.append((str(row.get(name)), lines))
    return Records(caption, tuple(items))
