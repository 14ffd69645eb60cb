"""Colour of a spectral picture: the wavelengths that its routes need, and what colour each route makes of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from livlab.kinds.picture.config import Colour
from livlab.kinds.picture.film import CameraFilm
from livlab.model.colour import channel_wavelengths, cie_weights, lab, stochastic_weights, thesis_weights, to_rgb
from livlab.units import FloatArray

if TYPE_CHECKING:
    from collections.abc import Sequence

SAME_NM = 1e-6
LAB = ("L", "a", "b")


@dataclass(frozen=True)
class ColourRoute:
    """One way from spectra to colour: which of the picture's wavelengths it uses, with which weights.

    Attributes
    ----------
    name
        thesis, stochastic or cie.
    indices
        Into the picture's wavelengths.
    weights
        (channel, wavelength) on those.
    """

    name: str
    indices: tuple[int, ...]
    weights: xr.DataArray

    def rgb(self, radiance: xr.DataArray, exposure: float = 1.0) -> xr.DataArray:
        """Linear sRGB of a spectral picture (or spectrum) on all the picture's wavelengths."""
        used = radiance.isel(wavelength=list(self.indices))
        used = used.assign_coords(wavelength=self.weights["wavelength"].to_numpy())
        return to_rgb(used * exposure, self.weights)

    @property
    def matrix(self) -> FloatArray:
        """(3, W) its weights, one column a wavelength it uses."""
        return np.asarray(self.weights.transpose("channel", "wavelength").to_numpy(), dtype=np.float64)


def colour_routes(colour: Colour, seed: int) -> tuple[FloatArray, dict[str, ColourRoute]]:
    """Every wavelength that the colour routes need, rising, and the routes.

    One path serves all wavelengths, so the routes of a picture share its samples: what differs between them is the
    route alone.

    Raises
    ------
    InputError, RangeError
        A κ, count or band that does not fit (`livlab.model.colour`).

    Examples
    --------
    >>> grid, routes = colour_routes(Colour(kappa_nm=1.0, count=1), seed=1)
    >>> grid, routes["thesis"].indices
    (array([435.8, 546.1, 700. ]), (0, 1, 2))
    """
    wanted: dict[str, FloatArray] = {}
    for name in map(str, colour.routes):
        if name == "cie":
            wanted[name] = np.asarray(colour.band.grid(), dtype=np.float64)
        else:
            drawn = channel_wavelengths(colour.kappa_nm, colour.count, stochastic=name == "stochastic", seed=seed)
            wanted[name] = np.unique(drawn.ravel())
    grid = _merged(list(wanted.values()))
    made: dict[str, ColourRoute] = {}
    for name, waves in wanted.items():
        indices = tuple(int(i) for i in np.abs(grid[None, :] - waves[:, None]).argmin(axis=1))
        used = grid[list(indices)]
        if name == "cie":
            weights = cie_weights(used, colour.illuminant, colour.observer)
        elif name == "stochastic":
            weights = stochastic_weights(used, colour.kappa_nm, colour.count, seed=seed)
        else:
            weights = thesis_weights(used, colour.kappa_nm, colour.count)
        made[name] = ColourRoute(name, indices, weights)
    return grid, made


def _merged(several: Sequence[FloatArray]) -> FloatArray:
    """The union, rising; wavelengths closer than rounding are one."""
    together = np.sort(np.concatenate(several))
    keep = np.concatenate(([True], np.diff(together) > SAME_NM))
    return np.asarray(together[keep])


@dataclass(frozen=True)
class MeanColour:
    """Mean colour of the lit body by one route, from its mean spectrum.

    Attributes
    ----------
    spectrum, covariance
        (W,) mean spectrum on all the picture's wavelengths, and its (W, W) covariance.
    weights
        (3, W) from it to linear sRGB as the picture shows it, exposure included.
    """

    spectrum: FloatArray
    covariance: FloatArray
    weights: FloatArray

    @property
    def rgb(self) -> FloatArray:
        """(3,) linear sRGB."""
        return np.asarray(self.weights @ self.spectrum)

    @property
    def rgb_se(self) -> FloatArray:
        """(3,) standard errors."""
        return np.asarray(np.sqrt(np.diag(self.weights @ self.covariance @ self.weights.T)))

    @property
    def lab(self) -> FloatArray:
        """(3,) L*, a*, b*."""
        return lab(self.rgb)

    def uncertain(self, what: str) -> tuple[float, float]:
        """A coordinate (L, a, b, chroma, hue in degrees) and its standard error."""

        def found(spectrum: FloatArray) -> float:
            return coordinate(lab(self.weights @ spectrum), what)

        return found(self.spectrum), propagated(found, self.spectrum, self.covariance, turn=what == "hue")


def propagated(
    function: Callable[[FloatArray], float], at: FloatArray, covariance: FloatArray, *, turn: bool = False
) -> float:
    """Standard error √(gᵀ C g) of a function of correlated numbers, g by central differences (JCGM 100:2008, 5.2).

    Parameters
    ----------
    turn
        Whether the function is an angle in degrees.

    Examples
    --------
    >>> round(propagated(lambda x: x[0] - x[1], np.zeros(2), np.array([[2.0, 1.0], [1.0, 2.0]])), 6)
    1.414214
    """
    slope = np.zeros(len(at))
    for k, step in enumerate(np.maximum(0.1 * np.sqrt(np.diag(covariance)), 1e-6 * np.abs(at) + 1e-12)):
        move = np.zeros(len(at))
        move[k] = step
        change = function(at + move) - function(at - move)
        slope[k] = ((change + 180.0) % 360.0 - 180.0 if turn else change) / (2.0 * step)
    spread = float(slope @ covariance @ slope)
    return float(np.sqrt(max(spread, 0.0)))


def coordinate(found: FloatArray, what: str) -> float:
    """One of L, a, b, chroma and hue (degrees, 0–360) of a CIELAB colour.

    >>> round(coordinate(np.array([30.0, 10.0, 10.0]), "hue"), 6)
    45.0
    """
    if what in LAB:
        return float(found[LAB.index(what)])
    if what == "chroma":
        return float(np.hypot(found[1], found[2]))
    return float(np.degrees(np.arctan2(found[2], found[1])) % 360.0)


def mean_colour(film: CameraFilm, route: ColourRoute, exposure: float) -> MeanColour:
    """Mean colour of the lit body as a picture shows it."""
    spectrum, covariance = film.mean_spectrum()
    weights = np.zeros((3, len(spectrum)))
    weights[:, list(route.indices)] = exposure * route.matrix
    return MeanColour(spectrum, covariance, weights)
