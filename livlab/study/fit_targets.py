"""What a fit aims at: measured curves, how each is normalised, and the residuals whose squares sum to its loss."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.metrics import pearson, rmse
from livlab.units import FloatArray

Loss = Literal["rmse", "chi2", "pearson", "colour"]
"""Σ r² is the mean square (rmse), Σ ((m − d)/σ)² (chi2), 1 − Pearson's ρ (pearson), or CIEDE2000² (colour)."""

Scaling = Literal["max", "sum", "none", "free"]
"""Both curves over their maximum or sum, as they are, or the model times the factor that fits best."""

DIFFERENCE = 1e-5
"""Step along a slope, as a share of the curve's level, for the residuals' derivatives."""


@dataclass(frozen=True, eq=False)
class Target:
    """One measured curve on the fit's wavelengths.

    Attributes
    ----------
    label
        Its name.
    use
        (W,) where it is compared.
    data, sigma
        (W,) the curve and its standard deviation (nan: not known), in its own unit.
    scaling, loss, weight
        How it is normalised, what is minimised, and how much it counts beside the others.
    colour
        From a spectrum on the used wavelengths to CIE L*a*b*; for the colour loss only.
    """

    label: str
    use: NDArray[np.bool_]
    data: FloatArray
    sigma: FloatArray
    scaling: Scaling = "max"
    loss: Loss = "rmse"
    weight: float = 1.0
    colour: Callable[[FloatArray], FloatArray] | None = None

    def __post_init__(self) -> None:
        n = int(self.use.sum())
        least = {"rmse": 2, "chi2": 1, "pearson": 3, "colour": 1}[self.loss]
        if n < least:
            raise InputError.of(
                f"measurement {self.label}", f"{n} points", f"must have {least} or more for loss {self.loss!r}",
                "Widen its band, or sample more wavelengths.",
            )  # fmt: skip
        if not np.isfinite(self.data[self.use]).all():
            raise InputError.of(f"measurement {self.label}", "nan", "must be finite in its band", "Narrow the band.")
        if self.loss == "chi2" and not (self.sigma[self.use] > 0).all():
            raise InputError.of(
                f"measurement {self.label}", "no standard deviation", "chi2 needs one at every point",
                "Name an sd_column, give sd, or use loss = 'rmse'.",
            )  # fmt: skip
        if self.loss == "colour" and self.colour is None:
            raise InputError.of(f"measurement {self.label}", None, "the colour loss needs a colour", "Give one.")

    @property
    def size(self) -> int:
        """Points compared."""
        return int(self.use.sum())

    def normalised(self, model: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Model, data and data's σ on the used points, as they are compared."""
        m, d, s = model[self.use], self.data[self.use], self.sigma[self.use]
        if self.scaling == "none":
            return m, d, s
        if self.scaling == "free":
            weight = np.where(np.isfinite(s) & (s > 0), 1.0 / np.maximum(s, 1e-300) ** 2, 1.0)
            under = float(np.sum(weight * m * m))
            return m * (float(np.sum(weight * m * d)) / under if under > 0 else math.nan), d, s
        size = np.max if self.scaling == "max" else np.sum
        a, b = float(size(m)), float(size(d))
        if not (a > 0 and b > 0):
            return np.full_like(m, np.nan), d, s
        return m / a, d / b, s / b

    def residuals(self, model: FloatArray, model_se: FloatArray | None = None) -> FloatArray:
        """(R,) the residuals; their squares sum to weight × loss. nan where the curve cannot be normalised.

        Parameters
        ----------
        model
            (W,) the modelled curve.
        model_se
            (W,) its Monte Carlo error, added to σ of a chi2 (at a fixed model: it must not change during a fit).
        """
        m, d, s = self.normalised(model)
        if self.loss == "chi2":
            extra = 0.0 if model_se is None else model_se[self.use] * np.abs(m) / np.maximum(model[self.use], 1e-300)
            r = (m - d) / np.sqrt(s**2 + extra**2)
        elif self.loss == "rmse":
            r = (m - d) / math.sqrt(len(m))
        elif self.loss == "pearson":
            r = (_standard(m) - _standard(d)) / math.sqrt(2.0 * len(m))
        else:
            assert self.colour is not None
            from livlab.metrics import colour_difference

            r = np.atleast_1d(colour_difference(self.colour(m), self.colour(d)))
        return np.asarray(math.sqrt(self.weight) * r)

    def slope(self, model: FloatArray, along: FloatArray, model_se: FloatArray | None) -> FloatArray:
        """(R,) derivative of the residuals along a change of the modelled curve."""
        level = float(np.abs(along[self.use]).max())
        if level == 0.0:
            return np.zeros_like(self.residuals(model, model_se))
        step = DIFFERENCE * float(np.abs(model[self.use]).max()) / level
        high = self.residuals(model + step * along, model_se)
        low = self.residuals(model - step * along, model_se)
        return np.asarray((high - low) / (2.0 * step))

    def scores(self, model: FloatArray) -> dict[str, float]:
        """RMSE and Pearson of the normalised curves, whatever was minimised; nan where there are too few points."""
        m, d, _ = self.normalised(model)
        found = {"rmse": rmse(m, d) if np.isfinite(m).all() else math.nan, "pearson": math.nan}
        if len(m) >= 3 and np.isfinite(m).all() and np.ptp(m) > 1e-9 * np.abs(m).max() and np.ptp(d) > 0:
            found["pearson"] = pearson(m, d)
        return found


def _standard(curve: FloatArray) -> FloatArray:
    """Mean 0 and mean square 1; nan for a constant."""
    off = curve - curve.mean()
    size = math.sqrt(float(np.mean(off**2)))
    return off / size if size > 1e-12 * max(float(np.abs(curve).max()), 1e-300) else np.full_like(curve, np.nan)
