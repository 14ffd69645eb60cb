"""The report of a run, whatever its kind: the page that all share, and between its sections the kind's own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from livlab.config.kinds import KINDS
from livlab.errors import EnvironmentProblem

if TYPE_CHECKING:
    from livlab.reports.figures import Pictures
    from livlab.reports.folder import RunData
    from livlab.reports.tables import ReportSection


def build_report(folder: Path) -> Path:
    """Write the report of a run folder, from its files alone.

    Raises
    ------
    InputError
        The folder is not a run folder, or is damaged.
    EnvironmentProblem
        The page cannot be written.
    """
    from livlab.reports import page

    return page.build_report(folder, own_sections)


def rebuild_report(folder: Path) -> Path:
    """Build the report of a run folder again; where that cannot be written, say that the result is kept.

    Raises
    ------
    InputError, EnvironmentProblem
        As `build_report`.
    """
    try:
        return build_report(folder)
    except OSError as error:
        raise EnvironmentProblem(
            f"The result is kept in {folder}, but its report cannot be written: {error.strerror or error}.",
            remedy=f"Mend that, then: livlab report {folder}",
        ) from error


def own_sections(run: RunData, pictures: Pictures) -> list[ReportSection]:
    """The sections that only runs of this kind have; a run that names no kind that there is, is shown as a spectral."""
    kind = KINDS.get(str(run.manifest.get("kind") or "spectral"), KINDS["spectral"])
    sections: list[ReportSection] = kind.load_report()(run, pictures)
    return sections
