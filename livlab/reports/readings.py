"""The readings, side by side: every place where they choose, of those that bear on the run's tissue."""

from __future__ import annotations

import pandas as pd

from livlab.reports.folder import RunData
from livlab.reports.tables import ReportSection, Text, from_frame, number


def readings_section(run: RunData) -> ReportSection:
    """Every place where the readings differ."""
    section = ReportSection("readings", "The readings, side by side")
    table = run.table("readings")
    if len(table):
        told = (
            "The thesis on the liver that livlab follows contradicts itself or physics in places. A reading is a named "
            "choice at each of them; rows where the readings differ are shaded."
        )
        if "bears" in table:
            bears = table["bears"].astype(str).str.lower().eq("true")
            left = int((~bears).sum())
            name = run.config.get("tissue", {}).get("inline", {}).get("name", "this tissue")
            if left:
                told += f" {left} more are about fibres, cells or states that {name} does not have (readings.csv)."
            table = table[bears].drop(columns="bears")
        section.content.append(Text(told))
        words = ["text", "trouble"]
        names = [c for c in table.columns if c not in {"row", "option", "choices", "differs", *words}]
        if "row" in table:
            table = table.assign(row=[number(r) if pd.notna(r) else "–" for r in table["row"]])
        section.content.append(
            from_frame(
                table,
                "One row a place where the text cannot be taken at its word; rows without a number are livlab's own.",
                only=["row", "option", *names, *words],
                titles={"text": "what the text says"},
                marked="differs",
            )
        )
    return section
