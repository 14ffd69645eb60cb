"""What the dossier's pages are made from: the record of `livlab validate`, and the run folders that it names."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from livlab.criteria import VERDICTS
from livlab.errors import InputError
from livlab.reports.folder import RunData, read_run
from livlab.reports.tables import claim_rows

RECORD = "validation.json"
MISSING = "MISSING"


@dataclass(frozen=True)
class GridCell:
    """A cell: its text, where it leads, a verdict shown as a badge, and a note beneath."""

    text: str = ""
    href: str = ""
    verdict: str = ""
    note: str = ""


@dataclass(frozen=True)
class CellGrid:
    """A table whose cells may be links and verdicts; the first column names the row."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[GridCell, ...], ...]
    numeric: tuple[str, ...] = ()
    folded: str = ""
    kind: str = "grid"


@dataclass(frozen=True)
class SiteEntry:
    """An experiment as the site shows it.

    Attributes
    ----------
    state, reason
        Complete, failed or left out; and why.
    run
        What its folder holds; None where there is no result.
    rows
        Its claims as the pages show them. Where there is no result, those the baseline knows of it, all MISSING.
    seconds
        What the run took when it ran.
    """

    name: str
    title: str
    description: str = ""
    group: str = ""
    kind: str = ""
    state: str = ""
    reason: str = ""
    run: RunData | None = None
    rows: tuple[Mapping[str, str], ...] = ()
    seconds: float = 0.0

    @property
    def report(self) -> str:
        """Its report within the site, "" where there is none."""
        return f"experiments/{self.name}.html" if self.run is not None else ""

    @property
    def tissue(self) -> str:
        """The organ it is about."""
        return self.run.tissue if self.run is not None else "liver"

    @property
    def counts(self) -> tuple[tuple[str, int], ...]:
        """Number of claims by verdict; an experiment without a result is missing whole."""
        if self.run is None:
            return ((MISSING, max(1, len(self.rows))),)
        found = Counter(r["verdict"] for r in self.rows)
        return tuple((v, found[v]) for v in VERDICTS if found[v])


@dataclass(frozen=True)
class Site:
    """The whole dossier: its folder, its file's content, its experiments in order, and the baseline."""

    out: Path
    record: Mapping[str, Any]
    entries: tuple[SiteEntry, ...]

    @property
    def dossier(self) -> Mapping[str, Any]:
        """The dossier's file, checked by whoever wrote the record."""
        found: Mapping[str, Any] = self.record["dossier"]
        return found

    def entry(self, name: str) -> SiteEntry:
        """An experiment by name; one that nobody knows is an entry without a result."""
        for e in self.entries:
            if e.name == name:
                return e
        return SiteEntry(name, name, state="failed", reason="there is no such experiment")


def read_site(out: Path) -> Site:
    """Read the record of a site, and every run folder that it names.

    A run folder that cannot be read is no error: its experiment is MISSING, with the reason.

    Raises
    ------
    InputError
        There is no record, or it is damaged.
    """
    file = out / RECORD
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        rows, holds = record["experiments"], record["baseline"]["holds"]
        entries = tuple(_entry(out, row, tuple(holds.get(row["name"], ()))) for row in rows)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError.of(
            "record", str(file), f"cannot be read ({error!r})", "Build it again: livlab validate."
        ) from error
    return Site(out, record, entries)


def _entry(out: Path, row: Mapping[str, Any], held: tuple[str, ...]) -> SiteEntry:
    run, reason = None, str(row["reason"])
    state = str(row["state"])
    if row["folder"] and state == "complete":
        try:
            run = read_run(out / str(row["folder"]))
        except InputError as error:
            state, reason = "failed", f"its run folder cannot be read: {error.message}"
    if run is None:
        reason = reason or "it has no result"
        rows: tuple[Mapping[str, str], ...] = tuple(_gone(claim, reason) for claim in held)
    else:
        rows = claim_rows(run.claims, dict(run.manifest.get("claim_notes", {})))
    return SiteEntry(
        name=str(row["name"]),
        title=str(row["title"] or row["name"]),
        description=str(row["description"]).strip(),
        group=str(row["group"]),
        kind=str(row["kind"]),
        state=state,
        reason=reason,
        run=run,
        rows=rows,
        seconds=float(run.manifest.get("seconds") or 0.0) if run is not None else float(row["seconds"]),
    )


def _gone(claim: str, reason: str) -> Mapping[str, str]:
    nothing = "not available"
    return {
        "criterion": claim,
        "value": nothing,
        "wanted": nothing,
        "group": "",
        "verdict": MISSING,
        "seconds": nothing,
        "reason": reason,
    }


def looked_up(site: Site, ours: Mapping[str, Any]) -> tuple[Mapping[str, Any] | None, str]:
    """Our number for one that the thesis prints: value, error and verdict, or why it is missing."""
    entry = site.entry(str(ours["experiment"]))
    if entry.run is None:
        return None, f"{entry.name}: {entry.reason}"
    if ours.get("claim"):
        table = entry.run.claims
        rows = table[table["criterion"] == ours["claim"]] if len(table) else table
        if not len(rows):
            return None, f"{entry.name} makes no claim {ours['claim']!r}"
        row = rows.iloc[0]
        if pd.isna(row["value"]):
            notes = dict(entry.run.manifest.get("claim_notes", {}))
            return None, str(notes.get(str(ours["claim"])) or "the claim has no value")
        return {"value": row["value"], "error": row["standard_error"], "verdict": str(row["verdict"])}, ""
    table = entry.run.table(str(ours["table"]))
    for column, wanted in ours["where"].items():
        if column not in table:
            return None, f"{entry.name}: {ours['table']}.csv has no column {column}"
        table = table[_same(table[column], wanted)]
    if not len(table) or ours["column"] not in table:
        return None, f"{entry.name}: {ours['table']}.csv has no such row"
    row = table.iloc[0]
    value = row[ours["column"]]
    try:
        value = float(value) * float(ours["scale"])
    except (TypeError, ValueError):
        return {"value": str(value), "error": None, "verdict": ""}, ""
    if pd.isna(value):
        return None, f"{entry.name}: {ours['table']}.csv has no value there"
    error = row[ours["error"]] * float(ours["scale"]) if ours.get("error") in table else None
    return {"value": value, "error": error, "verdict": ""}, ""


def _same(column: Any, wanted: Any) -> Any:
    if isinstance(wanted, (int, float)):
        return (pd.to_numeric(column, errors="coerce") - wanted).abs() < 1e-6
    return column.astype(object).where(column.notna(), "").astype(str) == str(wanted)
