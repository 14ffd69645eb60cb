"""How sure the verdicts are together: the family-wise error of all statistical claims, and what a false alarm costs."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from livlab.criteria import FALSE_ALARM, SIGMAS, Claim, FamilyError, family_error, read_claims
from livlab.criteria.family import AGAIN, LEVEL
from livlab.dossier.site import Site
from livlab.dossier.validate import Ended
from livlab.errors import InputError

CSV_COLUMNS = (
    "experiment", "group", "criterion", "verdict", "value", "standard_error", "reference", "tolerance", "at_least",
    "at_most", "needs", "p", "p_holm", "seconds", "again_seconds", "note",
)  # fmt: skip
"""Columns of the site's claims.csv; p is that of `InFamily`."""


def claims_of(ended: Mapping[str, Ended]) -> dict[str, tuple[Claim, ...]]:
    """Claims by experiment; an experiment that is not complete, or is damaged, has none."""
    return {name: _claims(e.folder if e.state == "complete" else None) for name, e in ended.items()}


def claims_of_site(site: Site) -> dict[str, tuple[Claim, ...]]:
    """The same of the run folders that a site names."""
    return {e.name: _claims(e.run.path if e.run is not None else None) for e in site.entries}


def _claims(folder: Path | None) -> tuple[Claim, ...]:
    table = None if folder is None else folder / "claims.csv"
    try:
        return read_claims(table) if table is not None and table.is_file() else ()
    except InputError:
        return ()


def family_of(claims: Mapping[str, tuple[Claim, ...]]) -> FamilyError:
    """The statistical claims of all experiments as one family."""
    return family_error((name, c) for name, own in claims.items() for c in own)


def family_record(found: FamilyError) -> dict[str, Any]:
    """The family as the record keeps it."""
    return {
        "rule_sigmas": SIGMAS,
        "false_alarm": FALSE_ALARM,
        "claims": found.claims,
        "decided": found.decided,
        "at_least_one_wrong_sidak": found.at_most,
        "at_least_one_wrong_bonferroni": found.bonferroni,
        "holm_level": LEVEL,
        "again_samples": AGAIN,
        "again_seconds_of_fails": sum(m.again_seconds for m in found.failed),
        "fails": len(found.failed),
        "fails_in_doubt": [f"{m.where}: {m.criterion}" for m in found.doubtful],
        "members": [asdict(m) for m in found.members],
    }


def claims_table(claims: Mapping[str, tuple[Claim, ...]]) -> str:
    """Every claim of the dossier as CSV, with its p-values among the others and what looking again takes."""
    family = {(m.where, m.criterion): m for m in family_of(claims).members}
    text = io.StringIO(newline="")
    table = csv.writer(text)
    table.writerow(CSV_COLUMNS)
    for name, own in claims.items():
        for c in own:
            m = family.get((name, c.criterion))
            numbers = (c.value, c.standard_error, c.reference, c.tolerance, c.at_least, c.at_most, c.needs)
            sure = ("", "", f"{c.seconds:.4g}", "") if m is None else (
                f"{m.p:.4g}", f"{m.p_holm:.4g}", f"{c.seconds:.4g}", f"{m.again_seconds:.4g}"
            )  # fmt: skip
            cells = ("" if x is None else repr(float(x)) for x in numbers)
            table.writerow([name, c.group, c.criterion, c.verdict, *cells, *sure, c.note])
    return text.getvalue()


__all__ = ["claims_of", "claims_of_site", "claims_table", "family_of", "family_record"]
