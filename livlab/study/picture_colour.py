"""Colour of a spectral picture: the wavelengths that its routes need, and what colour each route makes of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from livlab.config_picture import Colour
from livlab.model.colour import channel_wavelengths, cie_weights, stochastic_weights, thesis_weights, to_rgb
from livlab.model.colour.difference import SRGB_TO_XYZ
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
    """Mean colour of the lit body by one route, with its standard error.

    Attributes
    ----------
    rgb, rgb_se
        (3,) linear sRGB as the picture shows it, exposure included.
    """

    rgb: FloatArray
    rgb_se: FloatArray

    @property
    def lab(self) -> FloatArray:
        """(3,) L*, a*, b*."""
        return lab(self.rgb)

    def uncertain(self, what: str) -> tuple[float, float]:
        """A coordinate (L, a, b, chroma, hue in degrees) and its standard error.

        The channels share paths, so their errors may go together in any way: Σ |∂/∂c| σ_c bounds every one.
        """
        steps = np.maximum(1e-3 * np.abs(self.rgb), 1e-9)
        value = coordinate(self.lab, what)
        slopes = []
        for k in range(3):
            up, down = self.rgb.copy(), self.rgb.copy()
            up[k] += steps[k]
            down[k] -= steps[k]
            change = coordinate(lab(up), what) - coordinate(lab(down), what)
            if what == "hue":
                change = (change + 180.0) % 360.0 - 180.0
            slopes.append(change / (2 * steps[k]))
        return value, float(np.abs(slopes) @ self.rgb_se)


def lab(rgb: FloatArray) -> FloatArray:
    """(…, 3) CIELAB of linear sRGB, white (1, 1, 1) being its white."""
    from colour.models import XYZ_to_Lab, XYZ_to_xy

    return np.asarray(XYZ_to_Lab(np.asarray(rgb) @ SRGB_TO_XYZ.T, XYZ_to_xy(SRGB_TO_XYZ.sum(axis=1))))


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


def mean_colour(
    radiance: FloatArray,
    radiance_se: FloatArray,
    lit: np.ndarray[Any, np.dtype[np.bool_]],
    route: ColourRoute,
    exposure: float,
) -> MeanColour:
    """Mean colour of the lit body.

    Parameters
    ----------
    radiance, radiance_se
        (row, column, W) the picture and its standard error.
    lit
        (row, column) which pixels are of the lit body.
    route, exposure
        How colour is made.
    """
    used = list(route.indices)
    pixels = radiance[lit][:, used].astype(np.float64)
    errors = radiance_se[lit][:, used].astype(np.float64)
    mean = pixels.mean(axis=0)
    mean_se = np.sqrt((errors**2).sum(axis=0)) / len(pixels)
    weights = exposure * route.matrix
    return MeanColour(weights @ mean, np.abs(weights) @ mean_se)
