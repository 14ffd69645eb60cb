"""What the dossier's index says of the family-wise error of its claims."""

from __future__ import annotations

from typing import Any

from livlab.dossier.site import CellGrid, GridCell, Site
from livlab.dossier.sure import claims_of_site, family_of, family_record
from livlab.reports.tables import Text


def sure_words(site: Site) -> tuple[Any, ...]:
    """How sure the verdicts are together: family-wise error, every FAIL among the others, what a false alarm costs."""
    family = family_record(family_of(claims_of_site(site)))
    if not family.get("claims"):
        return (Text("No claim is statistical: every value is exact."),)
    m = int(family["claims"])
    content: list[Any] = [
        Text(
            f"{m} claims are statistical: their values have an error. A verdict needs a distance of more than two "
            f"standard errors, and is wrong with a chance of up to {_percent(family['false_alarm'])} where the truth "
            f"lies at the limit. Were every truth there, at least one of {m} would be wrong with a chance of up to "
            f"{_percent(family['at_least_one_wrong_sidak'])} if they are independent (Šidák), "
            f"{_percent(family['at_least_one_wrong_bonferroni'])} whatever their dependence (Bonferroni)."
        )
    ]
    fails = [x for x in family["members"] if x["verdict"] == "FAIL"]
    doubt = len(family["fails_in_doubt"])
    level = _percent(family["holm_level"])
    if fails:
        content.append(
            Text(
                f"{len(fails)} of them FAIL; {doubt or 'none'} could be a false alarm among so many: Holm's p above "
                f"{level}. To look again at every FAIL with {family['again_samples']:g} × the samples, half the error, "
                f"takes {spelt(float(family['again_seconds_of_fails']))}."
            )
        )
        rows = tuple(_row(site, x, family["holm_level"]) for x in fails)
        columns = ("claim that fails", "experiment", "p", "p among all (Holm)", "to look again")
        words = "p: chance of a value so far out, were the truth within its limits. Of exact claims there is none."
        content.append(CellGrid(words, columns, rows, columns[2:]))
    else:
        content.append(Text("None of them fails."))
    words = "Every claim, with its p and what looking again takes: claims.csv"
    content.append(CellGrid("", ("from",), ((GridCell(words, "claims.csv"),),), kind="link"))
    return tuple(content)


def _row(site: Site, x: dict[str, Any], level: float) -> tuple[GridCell, ...]:
    name = str(x["where"])
    return (
        GridCell(x["criterion"]),
        GridCell(name, f"{site.entry(name).group}.html#{name}"),
        GridCell(_small(x["p"])),
        GridCell(_small(x["p_holm"]), note="may be a false alarm" if x["p_holm"] > level else ""),
        GridCell(spelt(float(x["again_seconds"]))),
    )


def spelt(seconds: float) -> str:
    """A time in words.

    >>> spelt(0.25), spelt(90.0), spelt(600.0)
    ('0.2 s', '90 s', '10.0 min')
    """
    if seconds < 10:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"


def _small(p: float) -> str:
    return "< 1e-6" if p < 1e-6 else f"{p:.2g}"
