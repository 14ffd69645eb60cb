"""Exit light by direction: interpolation in the nodes' own variable, and cones of acceptance."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.quadrature import AngularGrid, gauss_legendre, interval_cosines, interval_place, lagrange
from livlab.units import FloatArray

ANGLES = 64
"""Exit directions per panel in the result."""


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
        basis = lagrange(ANGLES, interval_place(low, high, sine[inside]))
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
        end = float(interval_place(low, high, np.array(min(edge, high))))
        place = end * t
        mu = interval_cosines(top, low, high, place)
        span = (high - low) * (high + low) * 0.25 * math.pi * np.sin(math.pi * place) / (top * top * mu)
        weight = xr.DataArray(2 * math.pi * end * w * span, dims="mu_o", coords={"mu_o": mu})
        total = total + (exit_flux(result, mu) * weight).sum("mu_o")
        low = high
    total.attrs = {"units": "1", "long_name": f"scattered flux within cos >= {mu_min:g}"}
    return total


def flux_at(grid: AngularGrid, known: FloatArray, sine: FloatArray) -> FloatArray:
    """Interpolate flux per solid angle from an outer medium's nodes to other sines.

    The flux, not the radiance: that of a thin film rises as 1/µ towards grazing.
    """
    values = np.zeros_like(sine)
    low, start = 0.0, 0
    for high, count in zip(grid.breaks, grid.counts, strict=True):
        if start >= len(known):
            break
        inside = (sine >= low) & (sine <= high)
        values[inside] = lagrange(count, interval_place(low, high, sine[inside])) @ known[start : start + count]
        low, start = high, start + count
    return values


def angular_grid(stack: OpticalStack, outside: FloatArray) -> AngularGrid:
    """Exit directions common to all wavelengths, broken at the critical angles of rarer layers."""
    top = float(outside.mean())
    rarer = [float(x.n.mean()) for x in stack.layers if float(x.n.mean()) < top]
    grid = AngularGrid.of([*rarer, top], ANGLES, (top, 1.0))
    return AngularGrid(grid.breaks, (ANGLES,) * len(grid.breaks), grid.beam)
