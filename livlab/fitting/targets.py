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

ROUNDING = 1e-12
"""Share of a curve's level below which a change of its residuals is rounding."""


@dataclass(frozen=True, eq=False)
class CurveTarget:
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
    covariance
        (W, W) of the curve's errors beyond sigma, which hang together; None: there are none.
    wavelength_nm
        (W,) for words and neighbours; None: the points are equally far apart.
    """

    label: str
    use: NDArray[np.bool_]
    data: FloatArray
    sigma: FloatArray
    scaling: Scaling = "max"
    loss: Loss = "rmse"
    weight: float = 1.0
    colour: Callable[[FloatArray], FloatArray] | None = None
    covariance: FloatArray | None = None
    wavelength_nm: FloatArray | None = None

    def __post_init__(self) -> None:
        n = int(self.use.sum())
        least = {"rmse": 2, "chi2": 1 if self.scaling == "none" else 2, "pearson": 3, "colour": 1}[self.loss]
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

    @property
    def independent(self) -> int:
        """Numbers that the comparison leaves free to differ: a scale takes one, a correlation two; a colour has three.

        >>> everywhere = np.full(3, True)
        >>> CurveTarget("a", everywhere, np.ones(3), np.ones(3)).independent
        2
        """
        if self.loss == "colour":
            return 3
        return self.size - (2 if self.loss == "pearson" else 0 if self.scaling == "none" else 1)

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

    def whitening(self, model: FloatArray, noise: FloatArray | None = None) -> FloatArray | None:
        """(R, n) matrix that makes the errors of a chi2's difference independent and of size one; None for others.

        The difference of the curves as they are compared, model/a − data/b, has the covariance
        A (Σ_data/b² + Σ_model/a²) Aᵀ. Dividing by the maximum or the sum takes one number out of the data, and with it
        one direction: A = 1 − d sᵀ, d the divided data and s what takes their maximum or sum. That direction is left
        out (R = n − 1). The matrix is taken at one model and kept, since weights must not move during a search.

        Parameters
        ----------
        model
            (W,) the modelled curve near the optimum.
        noise
            (W, W) covariance of its Monte Carlo errors.
        """
        if self.loss != "chi2":
            return None
        m, d = model[self.use], self.data[self.use]
        inside = np.ix_(self.use, self.use)
        spread = np.diag(self.sigma[self.use] ** 2)
        if self.covariance is not None:
            spread = spread + self.covariance[inside]
        extra = np.zeros_like(spread) if noise is None else noise[inside]
        if self.scaling in ("none", "free"):
            factor = 1.0 if self.scaling == "none" else float(m @ d) / float(m @ m)
            return np.asarray(np.linalg.inv(np.linalg.cholesky(spread + factor**2 * extra)))
        size = np.max if self.scaling == "max" else np.sum
        a, b = float(size(m)), float(size(d))
        taken = np.ones(len(d)) if self.scaling == "sum" else np.eye(len(d))[int(np.argmax(d))]
        project = np.eye(len(d)) - np.outer(d / b, taken)
        eigen, vectors = np.linalg.eigh(project @ (spread / b**2 + extra / a**2) @ project.T)
        return np.asarray((vectors[:, 1:] / np.sqrt(eigen[1:])).T)

    def residuals(self, model: FloatArray, whitening: FloatArray | None = None) -> FloatArray:
        """(R,) the residuals; their squares sum to weight × loss. nan where the curve cannot be normalised.

        Parameters
        ----------
        model
            (W,) the modelled curve.
        whitening
            Of a chi2, as `whitening` gives it; made of the data's errors alone if not given.
        """
        m, d, _ = self.normalised(model)
        if self.loss == "chi2":
            white = self.whitening(model) if whitening is None else whitening
            assert white is not None
            if not np.isfinite(m).all():
                return np.full(len(white), np.nan)
            if self.scaling == "free":
                m, d = white @ model[self.use], white @ d
                under = float(m @ m)
                r = m * (float(m @ d) / under if under > 0 else math.nan) - d
            else:
                r = white @ (m - d)
        elif self.loss == "rmse":
            r = (m - d) / math.sqrt(len(m))
        elif self.loss == "pearson":
            r = (_standard(m) - _standard(d)) / math.sqrt(2.0 * len(m))
        else:
            assert self.colour is not None
            from livlab.metrics import colour_difference

            r = np.atleast_1d(colour_difference(self.colour(m), self.colour(d)))
        return np.asarray(math.sqrt(self.weight) * r)

    def slope(self, model: FloatArray, along: FloatArray, whitening: FloatArray | None = None) -> FloatArray:
        """(R,) derivative of the residuals along a change of the modelled curve."""
        level = float(np.abs(along[self.use]).max())
        if level == 0.0:
            return np.zeros_like(self.residuals(model, whitening))
        step = DIFFERENCE * float(np.abs(model[self.use]).max()) / level
        high = self.residuals(model + step * along, whitening)
        low = self.residuals(model - step * along, whitening)
        # A change that only scales a curve leaves its shape as it was; rounding must not make a slope of it.
        terms = np.abs(self.normalised(model)[0])
        size = terms.max() if self.loss != "chi2" or whitening is None else (np.abs(whitening) @ terms).max()
        moved = high - low
        return np.asarray(moved / (2.0 * step)) if np.abs(moved).max() > ROUNDING * size else np.zeros_like(moved)

    def scores(self, model: FloatArray) -> dict[str, float]:
        """RMSE, Pearson and (where there is one) colour difference of the compared curves, whatever was minimised."""
        m, d, _ = self.normalised(model)
        found = {"rmse": rmse(m, d) if np.isfinite(m).all() else math.nan, "pearson": math.nan}
        if len(m) >= 3 and np.isfinite(m).all() and np.ptp(m) > 1e-9 * np.abs(m).max() and np.ptp(d) > 0:
            found["pearson"] = pearson(m, d)
        if self.colour is not None and np.isfinite(m).all():
            from livlab.metrics import colour_difference

            found["colour difference"] = float(np.ravel(colour_difference(self.colour(m), self.colour(d)))[0])
        return found


def _standard(curve: FloatArray) -> FloatArray:
    """Mean 0 and mean square 1; nan for a constant."""
    off = curve - curve.mean()
    size = math.sqrt(float(np.mean(off**2)))
    return off / size if size > 1e-12 * max(float(np.abs(curve).max()), 1e-300) else np.full_like(curve, np.nan)
