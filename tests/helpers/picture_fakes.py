"""A camera that needs no renderer, for tests of what is built around one: a ball whose samples are drawn by numpy."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from livlab.config import parse_experiment
from livlab.kinds.picture.config import PictureExperiment
from livlab.kinds.picture.film import CameraFilm
from livlab.model.tissue.stack import OpticalStack

SMALL = """\
schema = 1
kind = "picture"
name = "small"
seed = 7
readings = ["thesis", "measured"]

[tissue.set]
"layers.parenchyma.index.outside" = "hold"
"layers.parenchyma.elements.lipid_and_water.parts.lipid.spectrum.outside" = "hold"

[camera]
position_mm = [0, -300, 0]
width = 24
height = 16

[[light]]
kind = "directional"
towards = [0, -1, 1]

[colour]
kappa_nm = 20
count = 2

[sampling]
spp = 12
pass_spp = 4
"""


def small(extra: str = "", old: str = "", new: str = "") -> PictureExperiment:
    """A small picture experiment, with a part replaced and more at its end."""
    assert old in SMALL
    config = parse_experiment(SMALL.replace(old, new, 1) + extra, source="small.toml")
    assert isinstance(config, PictureExperiment)
    return config


class BallCamera:
    """A lit ball: radiance falls with absorption; exponential samples, so that errors are known."""

    def __init__(self, config: PictureExperiment) -> None:
        self.config = config
        self.notes: tuple[str, ...] = ("a ball made of numbers",)
        rows, columns = config.camera.height, config.camera.width
        v, u = np.mgrid[:rows, :columns]
        r = np.hypot((u - columns / 2 + 0.5) / rows, (v - rows / 2 + 0.5) / rows) / 0.45
        self.shade = np.sqrt(np.clip(1 - r**2, 0, None))
        self.exposed: list[tuple[int, int]] = []

    @property
    def lit(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        return self.shade > 0.3

    def truth(self, stack: OpticalStack) -> np.ndarray[Any, Any]:
        absorbed = np.stack([i.rate * (1 - i.albedo) for i in stack.layers[-1].interactions]).sum(axis=0)
        return self.shade[..., None] * (0.5 / (1.0 + 4.0 * absorbed))

    def batch(self, spp: int) -> int:
        return 1

    def expose(self, film: CameraFilm, stack: OpticalStack, *, spp: int, seed: int) -> None:
        started = time.perf_counter()
        rng = np.random.default_rng([seed, film.passes])
        mean = self.truth(stack)
        for _ in range(spp):
            sample = mean * rng.exponential(size=(*mean.shape[:2], 1))
            film.total += sample
            film.square += sample**2
            film.spectra.append(sample[self.lit].mean(axis=0))
        film.batches += spp
        film.passes += 1
        film.seconds += time.perf_counter() - started
        self.exposed.append((spp, seed))

    def baseline(self, name: str, stack: OpticalStack, *, spp: int, seed: int) -> np.ndarray[Any, Any]:
        return 0.5 * self.truth(stack)
