"""The kinds of experiment: one row each, which says where the kind lives. A new kind is a folder and a row."""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from typing import Any

from livlab.config.schema import Experiment

_PLACE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
_TABLE = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class Kind:
    """One kind of experiment: where its parts live, as "module:attribute", imported on use, and its main table.

    Attributes
    ----------
    config
        The pydantic model of its files.
    job
        `prepare(config) -> work`, then `work(run) -> None`; `livlab.kinds.execute` calls both.
    report
        `sections(run, pictures) -> [sections]`: what its report shows between claims and provenance.
    main_table
        Stem of the CSV table that answers for a run (`RunResult.to_pandas`); of several the first that a run has.
    jobs
        Whether it is made of jobs, which a scheduler can spread.

    Raises
    ------
    ValueError
        A place that is none, or no main table.
    """

    config: str
    job: str
    report: str
    main_table: str | tuple[str, ...]
    jobs: bool = False

    def __post_init__(self) -> None:
        for place in (self.config, self.job, self.report):
            if not _PLACE.fullmatch(place):
                raise ValueError(f'{place!r} is no place: write "module:attribute".')
        if not self.main_tables or not all(map(_TABLE.fullmatch, self.main_tables)):
            raise ValueError(f"main_table = {self.main_table!r}: name the table that answers for a run of this kind.")

    @property
    def main_tables(self) -> tuple[str, ...]:
        """The main table, or those of which a run has one."""
        return (self.main_table,) if isinstance(self.main_table, str) else self.main_table

    def load_config(self) -> type[Experiment]:
        """The kind's pydantic model."""
        return _attribute(self.config)  # type: ignore[no-any-return]

    def load_job(self) -> Any:
        """The kind's job."""
        return _attribute(self.job)

    def load_report(self) -> Any:
        """The kind's own sections of a report."""
        return _attribute(self.report)


def _attribute(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


KINDS: dict[str, Kind] = {
    "brdf": Kind(
        "livlab.kinds.brdf.config:BrdfExperiment",
        "livlab.kinds.brdf.job:prepare",
        "livlab.kinds.brdf.report:brdf_sections",
        ("fits", "samples"),
    ),
    "fit": Kind(
        "livlab.kinds.fit.config:FitExperiment",
        "livlab.kinds.fit.job:prepare",
        "livlab.kinds.fit.report:fit_sections",
        "fit",
    ),
    "ladder": Kind(
        "livlab.kinds.checks.config:LadderExperiment",
        "livlab.kinds.checks.job:prepare_ladder",
        "livlab.kinds.checks.report:tissue_sections",
        "cost",
    ),
    "optics": Kind(
        "livlab.kinds.optics.config:OpticsExperiment",
        "livlab.kinds.optics.job:prepare",
        "livlab.kinds.optics.report:sections",
        ("efficiencies", "absorption"),
    ),
    "spectral": Kind(
        "livlab.kinds.spectral.config:SpectralExperiment",
        "livlab.kinds.spectral.job:prepare",
        "livlab.kinds.spectral.report:spectral_sections",
        "spectra",
    ),
    "picture": Kind(
        "livlab.kinds.picture.config:PictureExperiment",
        "livlab.kinds.picture.job:prepare",
        "livlab.kinds.picture.report:picture_sections",
        "pictures",
    ),
    "stress": Kind(
        "livlab.kinds.checks.config:StressExperiment",
        "livlab.kinds.checks.job:prepare_stress",
        "livlab.kinds.checks.report:tissue_sections",
        "stress",
    ),
    "study": Kind(
        "livlab.kinds.study.config:StudyExperiment",
        "livlab.kinds.study.job:prepare",
        "livlab.kinds.study.report:study_sections",
        "results",
        jobs=True,
    ),
}
"""Every kind of experiment that a file can ask for with `kind = "…"`."""
