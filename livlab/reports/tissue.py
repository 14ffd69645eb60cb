"""The section of a report about the tissue."""

from __future__ import annotations

from livlab.reports.folder import RunData
from livlab.reports.tables import ReportSection, from_frame, merge_readings


def tissue_section(run: RunData) -> ReportSection:
    """The tissue's parameters as each reading takes them."""
    section = ReportSection("tissue", "The tissue")
    table = run.table("tissue")
    if len(table):
        section.content.append(
            from_frame(
                merge_readings(table),
                "Layers from the lit side down, their elements and parameters, and where each is from.",
                only=["layer", "element", "parameter", "value", "unit", "reading", "source"],
            )
        )
    return section
