"""Experiments that check livlab itself: the catalogue of hard cases, and the ladder of solvers on one scene."""

from __future__ import annotations

import hashlib
from importlib.resources import files
from typing import Annotated, Literal, Self

from pydantic import Field

from livlab.acquire.instruments.hyperspectral_camera import HyperspectralCamera
from livlab.acquire.instruments.models import Instrument
from livlab.config.schema import Experiment, Text
from livlab.kinds.shared.sections import Wavelengths
from livlab.model.tissue.presets import TissueSpec
from livlab.model.tissue.readings import READINGS, Reading


class StressExperiment(Experiment):
    """The catalogue of hard cases; each case is a claim."""

    kind: Literal["stress"] = "stress"
    only: Text | None = Field(None, description="Cases whose name holds or matches this; all if not said.")
    slow: bool = Field(False, description="Whether the slow cases run too.")
    catalogue: Text = Field("", description="Hash of the catalogue and its trusted values; written by a run.")

    def resolve(self) -> Self:
        """With the catalogue's hash, so that a changed catalogue is another experiment."""
        folder = files("livlab.stress")
        raw = b"".join((folder / name).read_bytes() for name in ("catalogue.toml", "trusted.csv"))
        return self.model_copy(update={"catalogue": hashlib.sha256(raw).hexdigest()})


class LadderExperiment(Experiment):
    """Every solver on one scene: error against time."""

    kind: Literal["ladder"] = "ladder"
    tissue: TissueSpec = Field(default_factory=TissueSpec, description="The tissue.")
    reading: Reading = Field(default=READINGS["measured"], description="How the tissue is read.")
    wavelengths: Wavelengths = Field(description="Where the solvers are compared.")
    instrument: Instrument = Field(default=HyperspectralCamera(polarisation="crossed"), description="What looks at it.")
    budget_seconds: Annotated[float, Field(gt=0, le=86400.0)] = Field(60.0, description="Seconds to try for, about.")
    variant: Literal["llvm", "cuda"] = Field("llvm", description="Where walks run.")
    within: Annotated[float, Field(gt=0, le=100.0)] = Field(
        3.0, description="A solver passes if its errors are at most this many times what it states of itself."
    )

    def resolve(self) -> Self:
        """With every value of the tissue written out."""
        if self.tissue.inline is not None and not self.tissue.set:
            return self
        return self.model_copy(update={"tissue": self.tissue.resolve()})

    def datasets(self) -> tuple[str, ...]:
        """Datasets of the tissue, sorted."""
        return tuple(sorted(self.tissue.build().dataset_names()))
