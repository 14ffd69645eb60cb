"""The report's section on what was simulated: the plan of effects, from a run folder's plan.csv."""

from __future__ import annotations

import pandas as pd

from livlab.reports.tables import ReportSection, Text, from_frame


def simulated(plan: pd.DataFrame) -> ReportSection:
    """What each effect changes at most and whether it was kept; empty where a run simulated everything unasked."""
    section = ReportSection("effects", "What was simulated, and what the scene does not call for")
    if not len(plan):
        return section
    out = plan[plan["decision"].isin(["dropped", "forced off"]) & (plan["why"] != "together")]
    for reading, rows in out.groupby("reading", sort=False):
        section.content.append(Text(f"{reading}: left out {', '.join(map(str, rows['effect']))}."))
    if not len(out):
        section.content.append(Text("Every effect was kept: none stays below the tolerance and saves anything."))
    section.content.append(
        from_frame(
            plan,
            "Each effect: how far the instrument's value moves at most without it, and what leaving it out saves.",
            only=["reading", "effect", "bound", "decision", "predicted_saving", "measured_saving", "why"],
            titles={"bound": "changes at most"},
            folded="The plan",
        )
    )
    return section
