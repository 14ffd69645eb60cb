"""Several scenes of one fit: measurements of tissues that share some values and differ in others.

Each scene is a forward model of its own; joined they are one, whose curve is theirs end to end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from livlab.fitting.forward import LedgerForward, Response
from livlab.units import FloatArray

if TYPE_CHECKING:
    from livlab.model.tissue.stack import OpticalStack

SEEDS = 1_000_003
"""Between the seeds of one scene's walk and the next one's."""


class JointForward:
    """Forward models as one: (S W,) curves of S scenes end to end.

    Parameters
    ----------
    scenes
        Forward models on W wavelengths each.
    keys
        For each scene, the parameter that each of its paths follows.
    """

    def __init__(self, scenes: Sequence[LedgerForward], keys: Sequence[Mapping[str, str]]) -> None:
        self.scenes, self.keys = tuple(scenes), tuple(dict(k) for k in keys)
        self.size = len(self.scenes[0].wavelength_nm)
        self._asked = [True] * len(self.scenes)

    @property
    def recordings(self) -> list[dict[str, object]]:
        """Of all scenes."""
        return [{"scene": k + 1, **r} for k, scene in enumerate(self.scenes) for r in scene.recordings]

    def stack(self, values: Mapping[str, float]) -> OpticalStack:
        """The first scene's optical stack.

        Raises
        ------
        InputError, ConfigError
            Values at which any scene's tissue does not hold together.
        """
        stacks = [scene.stack(self._own(k, values)) for k, scene in enumerate(self.scenes)]
        return stacks[0]

    def record(
        self,
        centre: Mapping[str, float],
        others: Sequence[Mapping[str, float]] = (),
        *,
        seed: int = 1,
        coarser: float = 1.0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Walk anew in every scene, with draws of its own."""
        for k, scene in enumerate(self.scenes):

            def told(share: float, k: int = k) -> None:
                if progress is not None:
                    progress((k + share) / len(self.scenes))

            here, more = self._own(k, centre), [self._own(k, x) for x in others]
            scene.record(here, more, seed=seed + SEEDS * k, coarser=coarser, progress=told)

    def focus(self, use: NDArray[np.bool_] | None) -> None:
        """Answer at some of the (S W,) places only; a scene without any is left out."""
        whole = np.ones(self.size * len(self.scenes), dtype=bool) if use is None else use
        parts = whole.reshape(len(self.scenes), self.size)
        self._asked = [bool(part.any()) for part in parts]
        for scene, part in zip(self.scenes, parts, strict=True):
            scene.focus(part if part.any() else None)

    def answer(self, values: Mapping[str, float], *, gradient: bool = False) -> Response:
        """The curves end to end; derivatives by parameter, 0 where a scene does not know it."""
        n = self.size
        total = n * len(self.scenes)
        value, error, valid = np.full(total, np.nan), np.full(total, np.nan), np.zeros(total, dtype=bool)
        slopes = {key: np.zeros(total) for keys in self.keys for key in keys.values()} if gradient else {}
        for k, scene in enumerate(self.scenes):
            if not self._asked[k]:
                continue
            part = slice(k * n, (k + 1) * n)
            found = scene.answer(self._own(k, values), gradient=gradient)
            value[part], error[part], valid[part] = found.value, found.standard_error, found.valid
            for path, slope in found.slopes.items():
                slopes[self.keys[k][path]][part] += np.nan_to_num(slope)
        return Response(value, error, valid, slopes)

    def noise_covariance(self, values: Mapping[str, float]) -> FloatArray:
        """(S W, S W) covariance of the Monte Carlo errors: the scenes' walks are independent."""
        n = self.size
        made = np.zeros((n * len(self.scenes), n * len(self.scenes)))
        for k, scene in enumerate(self.scenes):
            if self._asked[k]:
                part = slice(k * n, (k + 1) * n)
                made[part, part] = scene.noise_covariance(self._own(k, values))
        return made

    def bias_covariance(self) -> FloatArray:
        """(S W, S W) second moments of what interpolation costs, each scene on its own."""
        n = self.size
        made = np.zeros((n * len(self.scenes), n * len(self.scenes)))
        for k, scene in enumerate(self.scenes):
            if self._asked[k]:
                made[k * n : (k + 1) * n, k * n : (k + 1) * n] = scene.bias_covariance()
        return made

    def _own(self, k: int, values: Mapping[str, float]) -> dict[str, float]:
        return {path: values[key] for path, key in self.keys[k].items()}


__all__ = ["JointForward"]
