"""What the report of a run that checks livlab itself shows between its claims and its provenance."""

from __future__ import annotations

from livlab.reports.figures import Pictures
from livlab.reports.folder import RunData
from livlab.reports.tables import ReportSection
from livlab.reports.tissue import tissue_section


def tissue_sections(run: RunData, _: Pictures) -> list[ReportSection]:
    """What an experiment shows that checks livlab itself; its tables have sections of their own."""
    return [tissue_section(run)]
