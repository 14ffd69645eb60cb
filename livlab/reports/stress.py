"""The report's section on hard cases, from the table that `livlab stress -o RUN/stress.csv` wrote."""

from __future__ import annotations

import pandas as pd

from livlab.reports.tables import ReportSection, Text, from_frame, number, with_error

TAKEN = "energy/thesis, what Algorithm 2 takes"
"""The case that measures which part of the thesis's light goes nowhere."""


def hard_cases(table: pd.DataFrame) -> ReportSection:
    """What was tried and what held: a sentence, where energy is not conserved, and every line of the table.

    Parameters
    ----------
    table
        `stress.csv` as read; an empty one gives an empty section.
    """
    section = ReportSection("stress", "Hard cases")
    if not len(table) or "verdict" not in table:
        return section
    counts = table["verdict"].value_counts()
    topics = ", ".join(dict.fromkeys(str(c).partition("/")[0] for c in table["criterion"]))
    told = ", ".join(f"{counts[v]} {v}" for v in ("PASS", "FAIL", "MISSING") if v in counts)
    section.content.append(
        Text(
            f"{len(table)} checks at the ends of what the solvers take ({topics}): {told}. Each is held against a "
            "closed form, a series in many digits, or adding–doubling at high order; where values are swept, the line "
            "shows the one that uses most of its allowance."
        )
    )
    taken = table[table["criterion"] == f"{TAKEN}: redirect_loss"]
    names = table["criterion"].astype(str)
    balance = table.loc[names.str.startswith("energy/") & names.str.endswith(": balance"), "value"].dropna()
    if len(taken) and len(balance):
        row = taken.iloc[0]
        where = str(row["at"]).replace("wavelength_nm = ", "")
        section.content.append(
            Text(
                "Reflected, transmitted, absorbed and lost light sum to 1 within "
                f"{number(float(balance.max()), 1)} in every reading; the thesis's only with what the cosine factor of "
                f"its Algorithm 2 takes, which no tissue absorbs: {with_error(row['value'], row['standard_error'])} of "
                f"the light at {where} nm."
            )
        )
    section.content.append(from_frame(_rows(table), "Every check.", marked="failed", folded="All hard cases"))
    return section


def _rows(table: pd.DataFrame) -> pd.DataFrame:
    case, quantity = table["criterion"].astype(str).str.partition(": ")[[0, 2]].T.to_numpy()
    at = table["at"].astype(object).fillna("").astype(str)
    pairs = zip(table["value"], table["standard_error"], strict=True)
    return pd.DataFrame(
        {
            "case": case,
            "quantity": [f"{q} ({a})" if a else q for q, a in zip(quantity, at, strict=True)],
            "value": [with_error(v, e) if e > 0 else number(v, 7) for v, e in pairs],
            "trusted": [number(x, 7) for x in table["reference"]],
            "difference": [number(x, 2) for x in table["difference"]],
            "allowed": [number(x, 2) for x in table["tolerance"]],
            "trusted by": table["trusted_by"].astype(object).fillna("–").astype(str),
            "s": [number(x, 2) if x > 0 else "" for x in table["seconds"]],
            "verdict": table["verdict"],
            "failed": table["verdict"] == "FAIL",
        }
    )
