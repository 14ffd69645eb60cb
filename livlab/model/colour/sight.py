"""What an eye sees under a light: observers, illuminants, and spectra taken to 1 nm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from livlab.errors import InputError
from livlab.model.colour.science import colour_science
from livlab.units import FloatArray

OBSERVERS = {
    "cie-1931-2": "CIE 1931 2 Degree Standard Observer",
    "cie-1964-10": "CIE 1964 10 Degree Standard Observer",
    "cie-2015-2": "CIE 2015 2 Degree Standard Observer",
    "cie-2015-10": "CIE 2015 10 Degree Standard Observer",
}
"""Observers by livlab's name, as colour-science calls them."""

ILLUMINANTS = {
    **{name: name for name in ("A", "D50", "D65", "E", "FL2", "FL7", "FL11")},
    **{name: name for name in ("LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1")},
    "xenon": "Kinoton 75P",
}
"""Illuminants by livlab's name: the CIE's (CIE 015:2018), and a measured xenon arc lamp of a projector."""

STEP_NM = 1.0


@dataclass(frozen=True)
class Sight:
    """An observer under an illuminant, at 1 nm.

    Attributes
    ----------
    fine
        (F,) wavelengths.
    seen
        (3, F) observer's functions times the illuminant's power.
    """

    fine: FloatArray
    seen: FloatArray

    def unseen(self, grid: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3,) shares of white's X, Y and Z below and above the wavelengths."""
        whole = self.seen.sum(axis=1)
        return tuple(self.seen[:, at].sum(axis=1) / whole for at in (self.fine < grid[0], self.fine > grid[-1]))

    @property
    def ripple(self) -> float:
        """Share of what is seen by which it departs from its mean over 21 nm: 0.02 in daylight, 0.4 under lines."""
        smooth = np.stack([np.convolve(x, np.full(21, 1.0 / 21.0), "same") for x in self.seen])
        return float(np.abs(self.seen - smooth).sum() / self.seen.sum())


@lru_cache(maxsize=64)
def sight(illuminant: str, observer: str) -> Sight:
    """An observer under an illuminant, by livlab's names.

    Raises
    ------
    InputError
        An unknown name.
    """
    for name, value, known in (("illuminant", illuminant, ILLUMINANTS), ("observer", observer, OBSERVERS)):
        if value not in known:
            raise InputError.of(name, value, f"must be one of {', '.join(known)}", "Pick one.")
    colour = colour_science()
    functions = colour.MSDS_CMFS[OBSERVERS[observer]]
    name = ILLUMINANTS[illuminant]
    light = colour.SDS_ILLUMINANTS[name] if name in colour.SDS_ILLUMINANTS else colour.SDS_LIGHT_SOURCES[name]
    low = max(functions.wavelengths[0], light.wavelengths[0])
    high = min(functions.wavelengths[-1], light.wavelengths[-1])
    fine = np.arange(low, high + STEP_NM / 2, STEP_NM)
    # The CIE tabulates its illuminants for linear interpolation (CIE 015:2018, 4).
    power = np.interp(fine, light.wavelengths, light.values)
    sensitivity = np.stack([np.interp(fine, functions.wavelengths, column) for column in functions.values.T])
    return Sight(fine, sensitivity * power)


def interpolator(grid: FloatArray, fine: FloatArray, how: str) -> FloatArray:
    """(F, W) matrix from values at an image's wavelengths to values at 1 nm; the ends are held."""
    if how not in ("linear", "cubic"):
        raise InputError.of("interpolation", how, 'must be "linear" or "cubic"', "Pick one.")
    inside = np.clip(fine, grid[0], grid[-1])
    units = np.eye(len(grid))
    if how == "linear" or len(grid) < 4:
        return np.stack([np.interp(inside, grid, unit) for unit in units], axis=1)
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(grid, units)(inside))
