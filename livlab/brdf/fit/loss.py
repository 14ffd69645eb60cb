"""Losses of a BRDF fit: what is compared, and the parameters of a fit depend on it (a lobe's width by a fifth)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from livlab.brdf.fit.data import Packed
from livlab.errors import InputError
from livlab.units import FloatArray

LossName = Literal["cosine-weighted-l2", "log", "cube-root", "chi2"]

LOSSES: dict[str, str] = {
    "cosine-weighted-l2": "squares of (f_model - f) cos(theta_i), each pixel alike (Ngan et al. 2005, eq. 3)",
    "log": "squares of the difference of ln(eps + f cos(theta_i)) (after Löw et al. 2012, section 5)",
    "cube-root": "squares of the difference of the cube root of f cos(theta_i) (after Bagher et al. 2012, section 4)",
    "chi2": "squares of (f_model - f) / standard error",
}
"""Each loss in words."""

LOG_FLOOR = 0.01
"""eps of the log loss, as a share of the median of |f cos θ_i|."""


@dataclass(frozen=True, eq=False)
class Loss:
    """Residuals g(f_model cos θ_i) − g(f cos θ_i), weighted by the root of the pixels that a sample stands for.

    Attributes
    ----------
    name, words
        Which one, and what it is, its constants included.
    clipped
        Values so far below zero that the log could not take them.
    """

    name: str
    words: str
    eps: FloatArray
    target: FloatArray
    root: FloatArray
    factor: FloatArray
    clipped: int

    def residual(self, predicted: FloatArray, channel: int) -> FloatArray:
        """Residuals (n,) of one channel."""
        y = predicted * self.factor[:, channel]
        return self.root * (self._g(y, channel) - self.target[:, channel])

    def slope(self, predicted: FloatArray, channel: int) -> FloatArray:
        """Derivative (n,) of the residuals with the predicted value."""
        y = predicted * self.factor[:, channel]
        scale = self.root * self.factor[:, channel]
        if self.name == "log":
            return np.asarray(scale / (self.eps[channel] + np.maximum(y, 0.0)))
        if self.name == "cube-root":
            return scale / (3.0 * np.cbrt(np.maximum(y, 1e-9)) ** 2)
        return scale

    def _g(self, y: FloatArray, channel: int) -> FloatArray:
        if self.name == "log":
            return np.asarray(np.log(self.eps[channel] + np.maximum(y, 0.0)))
        return np.cbrt(y) if self.name == "cube-root" else y


def make_loss(name: str, data: Packed) -> Loss:
    """A loss on packed samples.

    Raises
    ------
    InputError
        An unknown name; chi2 without standard errors; log of channels that are all zero.
    """
    if name not in LOSSES:
        raise InputError.of("loss", name, f"must be one of {', '.join(LOSSES)}", "Name one of them.")
    factor = np.repeat(data.cos_i[:, None], data.value.shape[1], axis=1)
    root = np.sqrt(data.pixels)
    words, clipped = LOSSES[name], 0
    eps = np.zeros(data.value.shape[1])
    if name == "chi2":
        if not np.all(np.isfinite(data.error) & (data.error > 0)):
            raise InputError.of(
                "loss", name, "needs a standard error > 0 for every sample", "Extract with variance=, or use another."
            )
        return Loss(name, words, eps, data.value / data.error, np.ones(data.size), 1.0 / data.error, 0)
    y = data.value * factor
    if name == "log":
        eps = LOG_FLOOR * np.median(np.abs(y), axis=0)
        if not np.all(eps > 0):
            raise InputError.of("loss", name, "cannot take channels whose median is 0", "Use cosine-weighted-l2.")
        low = y < -0.5 * eps
        clipped = int(np.count_nonzero(low))
        words += f"; eps {np.array2string(eps, precision=3)} 1/sr"
        target = np.log(eps + np.where(low, -0.5 * eps, y))
    else:
        target = np.cbrt(y) if name == "cube-root" else y
    return Loss(name, words, eps, target, root, factor, clipped)
