"""Exit light by direction: interpolation in the nodes' own variable, and cones of acceptance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.quadrature import AngularGrid, SineInterval, gauss_legendre, lagrange
from livlab.units import FloatArray

ANGLES = 64
"""Exit directions per panel in the result."""

CONE_SHARE = 0.12
"""Share of the stated error by angle, integrated over a cone, that the light in it has: errors change sign."""


@dataclass(frozen=True)
class ExitDirections:
    """Exit directions on one side of the stack, common to all wavelengths: (M,) cosines and what belongs to them.

    Attributes
    ----------
    breaks
        Upper ends of the panels in the sine.
    cosines, sines, solid_angle
        Of the directions; a node's solid angle in sr.
    """

    breaks: tuple[float, ...]
    cosines: FloatArray
    sines: FloatArray
    solid_angle: FloatArray

    @classmethod
    def of(cls, stack: OpticalStack, outside: FloatArray) -> ExitDirections:
        """Broken at the critical angles of rarer layers."""
        top = float(outside.mean())
        rarer = [float(x.n.mean()) for x in stack.layers if float(x.n.mean()) < top]
        breaks = AngularGrid.of([*rarer, top], ANGLES, (top, 1.0)).breaks
        grid = AngularGrid(breaks, (ANGLES,) * len(breaks), (top, 1.0))
        mu = grid.cosines(top)[1:]
        weights = 2 * math.pi * grid.flux()[1:] / (top * top * mu)
        return cls(breaks, mu, np.sqrt((1 - mu) * (1 + mu)), weights)

    def cone(self, error: FloatArray, mu_min: float) -> FloatArray:
        """(...) error of the light in a cone from the error (..., M) of the flux per solid angle."""
        order = np.argsort(self.sines)
        # 1 − µ without cancellation: a cone of a degree is 1.5e-4 of the hemisphere.
        depth = self.sines[order] ** 2 / (1.0 + self.cosines[order])
        edges = np.concatenate([[0.0], 0.5 * (depth[1:] + depth[:-1]), [1.0]])
        area = 2.0 * math.pi * np.diff(np.minimum(edges, 1.0 - mu_min))
        return np.asarray(CONE_SHARE * (error[..., order] @ area))


def exit_flux(result: xr.Dataset, mu_o: FloatArray) -> xr.DataArray:
    """Scattered flux per solid angle in 1/sr at any cosines above the stack, interpolated as it was solved.

    Parameters
    ----------
    result
        From `adding_doubling`.
    mu_o
        Cosines of exit in [0, 1].

    Returns
    -------
    xr.DataArray
        (wavelength, mu_o).

    Raises
    ------
    InputError
        A cosine outside [0, 1].
    """
    mu_o = np.atleast_1d(np.asarray(mu_o, dtype=np.float64))
    if not ((mu_o >= 0) & (mu_o <= 1)).all():
        raise InputError.of("mu_o", mu_o, "must be in [0, 1]", "Give cosines of exit directions.")
    breaks = np.atleast_1d(result.attrs["angular_breaks"])
    top = float(breaks[-1])
    sine = top * np.sqrt((1 - mu_o) * (1 + mu_o))
    known = result.reflectance_angular.to_numpy()
    values = np.empty((known.shape[0], mu_o.size))
    low = 0.0
    for k, high in enumerate(float(b) for b in breaks):
        inside = (sine >= low) & (sine <= high)
        basis = lagrange(ANGLES, SineInterval(low, high).place(sine[inside]))
        values[:, inside] = known[:, k * ANGLES : (k + 1) * ANGLES] @ basis.T
        low = high
    return xr.DataArray(
        values,
        dims=("wavelength", "mu_o"),
        coords={"wavelength": result.wavelength, "mu_o": mu_o},
        attrs={"units": "1/sr"},
    )


def cone_fraction(result: xr.Dataset, mu_min: float) -> xr.DataArray:
    """Share of the incident flux that leaves scattered within a cone about the normal: 2π ∫ L µ dµ, µ ≥ mu_min.

    A collinear sensor with acceptance half-angle α sees mu_min = cos α. Surface reflection, and what inner
    interfaces return unscattered, are not in it.

    Parameters
    ----------
    result
        From `adding_doubling`.
    mu_min
        Least cosine of exit, in [0, 1]; 0 takes the hemisphere.

    Returns
    -------
    xr.DataArray
        (wavelength,).

    Raises
    ------
    InputError
        mu_min outside [0, 1].
    """
    if not 0 <= mu_min <= 1:
        raise InputError.of("mu_min", mu_min, "must be in [0, 1]", "Give the cosine of the cone's half-angle.")
    breaks = [float(b) for b in np.atleast_1d(result.attrs["angular_breaks"])]
    top = breaks[-1]
    edge = top * math.sqrt((1 - mu_min) * (1 + mu_min))
    t, w = gauss_legendre(2 * ANGLES)
    total: xr.DataArray = xr.zeros_like(result.reflectance)
    low = 0.0
    for high in breaks:
        if edge <= low:
            break
        # In the panel's own variable, where the flux is a polynomial.
        panel = SineInterval(low, high)
        end = float(panel.place(np.array(min(edge, high))))
        place = end * t
        mu = panel.cosines(top, place)
        span = panel.flux(place) / (top * top * mu)
        weight = xr.DataArray(2 * math.pi * end * w * span, dims="mu_o", coords={"mu_o": mu})
        total = total + (exit_flux(result, mu) * weight).sum("mu_o")
        low = high
    total.attrs = {"units": "1", "long_name": f"scattered flux within cos >= {mu_min:g}"}
    return total


def cone_error(result: xr.Dataset, mu_min: float) -> xr.DataArray:
    """Stated error of `cone_fraction`: `CONE_SHARE` of ∫ error(µ) dΩ over the cone, from `reflectance_angular_error`.

    Arguments, shape and errors as in `cone_fraction`.
    """
    if not 0 <= mu_min <= 1:
        raise InputError.of("mu_min", mu_min, "must be in [0, 1]", "Give the cosine of the cone's half-angle.")
    mu = result["mu_o"].to_numpy()
    sines, weights = np.sqrt((1 - mu) * (1 + mu)), result["solid_angle"].to_numpy()
    directions = ExitDirections(tuple(np.atleast_1d(result.attrs["angular_breaks"])), mu, sines, weights)
    error = directions.cone(result["reflectance_angular_error"].to_numpy(), mu_min)
    return xr.DataArray(error, coords={"wavelength": result["wavelength"]}, dims="wavelength", attrs={"units": "1"})


def flux_at(grid: AngularGrid, known: FloatArray, sine: FloatArray) -> FloatArray:
    """Interpolate flux per solid angle from an outer medium's nodes to other sines.

    The flux, not the radiance: that of a thin film rises as 1/µ towards grazing.
    """
    values = np.zeros_like(sine)
    start = 0
    for interval, count in grid.intervals:
        if start >= len(known):
            break
        inside = (sine >= interval.low) & (sine <= interval.high)
        values[inside] = lagrange(count, interval.place(sine[inside])) @ known[start : start + count]
        start += count
    return values
