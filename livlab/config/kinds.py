"""The kinds of experiment: one row each, which says where the kind lives."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

from livlab.config.schema import Experiment


@dataclass(frozen=True)
class Kind:
    """Where one kind of experiment lives, as "module:attribute", imported on use, and whether it is made of jobs."""

    model: str
    job: str
    jobs: bool = False

    def load_model(self) -> type[Experiment]:
        """The kind's pydantic model."""
        return _attribute(self.model)  # type: ignore[no-any-return]

    def load_job(self) -> Any:
        """The kind's job: `prepare(config) -> work`, then `work(run) -> None`; `livlab.kinds.execute` calls both."""
        return _attribute(self.job)


def _attribute(spec: str) -> Any:
    module, _, name = spec.partition(":")
    return getattr(importlib.import_module(module), name)


KINDS: dict[str, Kind] = {
    "brdf": Kind("livlab.kinds.brdf.config:BrdfExperiment", "livlab.kinds.brdf.job:prepare"),
    "fit": Kind("livlab.kinds.fit.config:FitExperiment", "livlab.kinds.fit.job:prepare"),
    "ladder": Kind("livlab.kinds.checks.config:LadderExperiment", "livlab.kinds.checks.job:prepare_ladder"),
    "optics": Kind("livlab.kinds.optics.config:OpticsExperiment", "livlab.kinds.optics.job:prepare"),
    "spectral": Kind("livlab.kinds.spectral.config:SpectralExperiment", "livlab.kinds.spectral.job:prepare"),
    "picture": Kind("livlab.kinds.picture.config:PictureExperiment", "livlab.kinds.picture.job:prepare"),
    "stress": Kind("livlab.kinds.checks.config:StressExperiment", "livlab.kinds.checks.job:prepare_stress"),
    "study": Kind("livlab.kinds.study.config:StudyExperiment", "livlab.kinds.study.job:prepare", jobs=True),
}
"""Every kind of experiment that a file can ask for with `kind = "…"`."""
