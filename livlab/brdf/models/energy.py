"""How much light a BRDF model throws back, by quadrature that follows its lobe."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from livlab.brdf.models.model import Model, model
from livlab.units import FloatArray


def directional_albedo(
    which: str | Model, parameters: Mapping[str, float], theta_i: ArrayLike, *, order: int = 96
) -> xr.DataArray:
    """Directional-hemispherical reflectance ∫ f cos θ_o dω_o for each angle of incidence.

    Polar coordinates about the mirror direction, radii packed around it by a sinh and ending at the horizon, so that
    narrow lobes and matt surfaces are integrated alike (Gauss–Legendre both ways).

    Parameters
    ----------
    which
        A model or its name.
    parameters
        One number each.
    theta_i
        (k,) angles in radians, below π/2.
    order
        Nodes each way; the default gives 1e-5 for roughness down to 0.01.

    Examples
    --------
    >>> round(float(directional_albedo("lambert", {"kd": 0.5}, [0.7])[0]), 9)
    0.5
    """
    chosen = model(which)
    angles = np.atleast_1d(np.asarray(theta_i, dtype=np.float64))
    found = [_albedo(chosen, parameters, float(t), order) for t in angles]
    return xr.DataArray(
        found,
        dims="theta_i",
        coords={"theta_i": ("theta_i", angles, {"units": "rad"})},
        attrs={"units": "1", "long_name": "directional-hemispherical reflectance", "model": chosen.name},
    )


def _albedo(chosen: Model, parameters: Mapping[str, float], theta: float, order: int) -> float:
    nodes, weights = np.polynomial.legendre.leggauss(order)
    phi, w_phi = 0.5 * np.pi * (nodes + 1.0), 0.5 * np.pi * weights
    # Where a ray that leaves the mirror direction towards phi meets the horizon.
    end = np.arctan2(np.cos(theta), -np.sin(theta) * np.cos(phi))
    packed = 3e-3
    u_end = np.arcsinh(end / packed)
    u = 0.5 * (nodes[:, None] + 1.0) * u_end
    r = packed * np.sinh(u)
    w_r = 0.5 * weights[:, None] * u_end * packed * np.cosh(u)
    wo = _around_mirror(theta, r, phi)
    wi = np.array([np.sin(theta), 0.0, np.cos(theta)])
    f = chosen.evaluate(wi, wo, parameters)
    # The half circle twice: the BRDF does not tell left from right.
    return float(2.0 * np.sum(f * np.maximum(wo[..., 2], 0.0) * np.sin(r) * w_r * w_phi))


def _around_mirror(theta: float, r: FloatArray, phi: FloatArray) -> FloatArray:
    """Directions at angle r from the mirror direction of incidence theta, phi = 0 rising towards the normal."""
    s, c = np.sin(theta), np.cos(theta)
    mirror, up, side = np.array([-s, 0.0, c]), np.array([c, 0.0, s]), np.array([0.0, 1.0, 0.0])
    along = np.cos(phi)[:, None] * up + np.sin(phi)[:, None] * side
    return np.asarray(np.cos(r)[..., None] * mirror + np.sin(r)[..., None] * along)
