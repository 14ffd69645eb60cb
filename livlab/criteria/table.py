"""claims.csv and the notes beside it, written and read; tables of older runs, too."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from livlab.core.files import first_line, readable
from livlab.criteria.claim import Claim
from livlab.criteria.judging import VERDICTS, former_judge
from livlab.criteria.limits import BOUNDS, GROUPS, metric_named, wanted_then
from livlab.criteria.rounding import round_to_error
from livlab.errors import InputError

LARGEST_BYTES = 1 << 26
"""Of a table of claims."""

FORMER_COLUMNS = ("criterion", "value", "standard_error", "reference", "tolerance", "verdict", "seconds")
"""Columns of claims.csv before result version 4."""

COLUMNS = (*FORMER_COLUMNS, "group", "at_least", "at_most", "needs")
"""Columns of claims.csv, in order."""

FORMER_VERDICTS = ("PASS", "FAIL", "MISSING")


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
        writer.writerows(_row(c) for c in rows)
    notes = _notes(rows)
    beside = notes_path(path)
    if notes:
        beside.write_text(notes, encoding="utf-8")
    else:
        beside.unlink(missing_ok=True)


def read_claims(path: Path) -> tuple[Claim, ...]:
    """Read what `write_claims` wrote; each verdict is held against its numbers.

    A table of a run before result version 4 has the first seven columns only: its verdicts are those given then, by
    the rule of then, and groups and limits are told from the names.

    Raises
    ------
    InputError
        If the columns are neither, a cell is no number, or a verdict contradicts its numbers.
    """
    notes, rows = _read(path)
    header: Sequence[str] = rows[0] if rows else []
    former = tuple(header) == FORMER_COLUMNS
    if not former and tuple(header) != COLUMNS:
        raise InputError.of(str(path), list(header), f"the columns must be {','.join(COLUMNS)}", "Write it anew.")
    claims = []
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise InputError.of(f"{path}, line {line}", row, f"must have {len(header)} cells", "Write it anew.")
        cells = dict(zip(header, row, strict=True))
        known = FORMER_VERDICTS if former else VERDICTS
        if cells["verdict"] not in known:
            bound = f"must be {', '.join(known[:-1])} or {known[-1]}"
            raise InputError.of(f"{path}, line {line}", cells["verdict"], bound, "Write it anew.")
        claims.append(_claim(f"{path}, line {line}", cells, str(notes.get(cells["criterion"], "")), former))
    return tuple(claims)


def under_former_rule(claims: Iterable[Claim]) -> dict[str, bytes]:
    """claims.csv and claims.notes.json as a livlab before result version 4 would have written them.

    One limit alone has no verdict there, unless the metric itself ends on the other side: it is left out.
    """
    then: list[list[str]] = []
    notes: dict[str, str] = {}
    for c in claims:
        value, error, verdict, note = c.value, c.standard_error, str(c.verdict), c.note
        reference, tolerance = _two_sided(c)
        if c.verdict != "MISSING":
            if reference is None or tolerance is None or value is None or error is None:
                continue
            value, error = round_to_error(value, error), round_to_error(error, error)
            verdict, note = former_judge(value, error, reference, tolerance)
        numbers = (value, error, reference, tolerance)
        then.append([c.criterion, *(_cell(x) for x in numbers), verdict, f"{c.seconds:.4g}"])
        notes |= {c.criterion: note} if note else {}
    text = io.StringIO(newline="")
    csv.writer(text).writerows([FORMER_COLUMNS, *then])
    made = {"claims.csv": text.getvalue().encode()}
    if notes:
        made["claims.notes.json"] = (json.dumps(notes, indent=2, ensure_ascii=False) + "\n").encode()
    return made


def completed(rows: Sequence[Mapping[Any, Any]]) -> list[dict[Any, Any]]:
    """Rows of a table of claims with the columns of today; those that an older table lacks are told from the names."""
    made = []
    for row in rows:
        if "group" in row:
            made.append(dict(row))
            continue
        numbers = [_number(row.get(k)) for k in ("reference", "tolerance")]
        try:
            aim = wanted_then(str(row["criterion"]), *numbers)
        except InputError:  # a damaged table: what it says is shown
            aim = wanted_then(str(row["criterion"]), None, None)
        limits = {"at_least": aim.at_least, "at_most": aim.at_most, "needs": None}
        made.append({**row, "group": aim.group, **limits})
    return made


def notes_path(path: Path) -> Path:
    """Where the notes of a table lie."""
    return path.with_suffix(".notes.json")


def _notes(claims: Iterable[Claim]) -> str:
    notes = {c.criterion: c.note for c in claims if c.note}
    return json.dumps(notes, indent=2, ensure_ascii=False) + "\n" if notes else ""


def _row(c: Claim) -> list[str]:
    numbers = (c.value, c.standard_error, c.reference, c.tolerance)
    limits = (c.at_least, c.at_most, c.needs)
    return [c.criterion, *map(_cell, numbers), c.verdict, f"{c.seconds:.4g}", c.group, *map(_cell, limits)]


def _read(path: Path) -> tuple[dict[str, Any], list[list[str]]]:
    beside = notes_path(path)
    notes: dict[str, Any] = {}
    try:
        text = readable(path, "claims", LARGEST_BYTES).read_text(encoding="utf-8")
        if beside.exists():
            notes = json.loads(readable(beside, "claims", LARGEST_BYTES).read_text(encoding="utf-8"))
        if not isinstance(notes, dict):
            raise ValueError(f"{beside.name} is no table")
        return notes, list(csv.reader(io.StringIO(text, newline="")))
    except InputError:
        raise
    except (ValueError, RecursionError, csv.Error) as error:
        raise InputError.of(str(path), first_line(error), "is no table of claims", "Write it anew.") from error


def _claim(where: str, cells: Mapping[str, str], note: str, former: bool) -> Claim:
    named = ("value", "standard_error", "reference", "tolerance", "at_least", "at_most", "needs")
    try:
        numbers: dict[str, Any] = {k: float(cells[k]) if cells.get(k) else None for k in named}
        seconds = float(cells["seconds"])
    except ValueError as error:
        row = list(cells.values())
        raise InputError.of(where, row, "holds a cell that is no number", "Mend it.") from error
    if former:
        aim = wanted_then(cells["criterion"], numbers["reference"], numbers["tolerance"])
        group, rule = aim.group, "tolerance"
        numbers |= {"at_least": aim.at_least, "at_most": aim.at_most}
    else:
        group, rule = cells["group"], "two errors"  # type: ignore[assignment]
        if group not in GROUPS:
            raise InputError.of(where, group, f"must be {', '.join(GROUPS[:-1])} or {GROUPS[-1]}", "Write it anew.")
    told: dict[str, Any] = {"verdict": cells["verdict"], "rule": rule, "group": group}
    return Claim(cells["criterion"], **numbers, **told, seconds=seconds, note=note)


def _two_sided(c: Claim) -> tuple[float | None, float | None]:
    """Reference and tolerance; of a claim given by its limits, their middle and half their distance."""
    if c.reference is not None or (c.at_least is None and c.at_most is None):
        return c.reference, c.tolerance
    least, most = BOUNDS.get(metric_named(c.criterion), (-math.inf, math.inf))
    low, high = least if c.at_least is None else c.at_least, most if c.at_most is None else c.at_most
    if not (math.isfinite(low) and math.isfinite(high)):
        return None, None
    return (low + high) / 2, (high - low) / 2


def _cell(number: float | None) -> str:
    return "" if number is None else repr(float(number))


def _number(value: Any) -> float | None:
    try:
        found = float(value)
    except (TypeError, ValueError):
        return None
    return found if math.isfinite(found) else None
