"""A picture experiment made ready: what its job, its files and its study of costs share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from livlab.kinds.picture.claims import Key
from livlab.kinds.picture.colour import ColourRoute
from livlab.kinds.picture.config import PictureExperiment
from livlab.kinds.picture.film import CameraFilm
from livlab.kinds.picture.plan import PicturePlan
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.stack import OpticalStack
from livlab.units import FloatArray


class Photographer(Protocol):
    """What takes the pictures of an experiment; `livlab.kinds.picture.camera.PictureCamera` is the one."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the report must say of the scene, once it has been exposed."""

    @property
    def lit(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(row, column) pixels that see nothing but the body where it is lit."""

    def batch(self, spp: int) -> int:
        """Samples of a batch, for a picture of so many samples a pixel."""

    def expose(self, film: CameraFilm, stack: OpticalStack, *, spp: int, seed: int) -> None:
        """Add one pass of samples to a film."""

    def baseline(self, name: str, stack: OpticalStack, *, spp: int, seed: int) -> FloatArray:
        """(row, column, W) the scene with an older model of appearance in the tissue's place."""


@dataclass
class Work:
    """A picture experiment made ready: everything that its parts need."""

    config: PictureExperiment
    grid: FloatArray
    routes: dict[str, ColourRoute]
    stacks: dict[Key, OpticalStack]
    curves: dict[Key, OpticalStack]
    plans: dict[Key, PicturePlan]
    camera: Photographer
    make_camera: Callable[[PictureExperiment], Photographer]
    costs: list[dict[str, object]] = field(default_factory=list)

    def reading(self, name: str) -> Reading:
        """A reading by name."""
        return next(r for r in self.config.all_readings if r.name == name)
