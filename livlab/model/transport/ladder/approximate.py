"""The two approximate solvers as an instrument reads them: two fluxes, and diffusion's dipole."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.diffusion import diffusion
from livlab.model.transport.fresnel import diffuse_fresnel, fresnel
from livlab.model.transport.geometry import Readout
from livlab.model.transport.kubelka_munk import kubelka_munk
from livlab.model.transport.ladder.domain import whole_plane
from livlab.model.transport.moments import reduced_coefficients
from livlab.units import FloatArray

KUBELKA_MUNK_BOUND = 0.14
"""Largest error of the two fluxes for a collimated beam within their domain, as a share of the value."""

DIFFUSION_BOUND = 0.03
"""The same of the dipole's total, and:"""

DIFFUSION_RING_BOUND = 0.25
"""of what it says leaves at a distance, from 4 to 8 transport paths from the beam (g 0 and 0.8, n 1 and 1.4, reduced
albedo 0.98 and 0.998: from −21 to +24 %)."""


def kubelka_munk_value(stack: OpticalStack, view: Readout) -> FloatArray:
    """(W,) what the instrument reads if all light inside is as bright in every direction of a half-space."""
    solved = kubelka_munk(stack, mu0=math.cos(view.source.angle_rad))
    share = _cone_share(stack, view, lambda n, n_above, mu: np.ones_like(mu))
    whole = solved["reflectance"].to_numpy() * share
    return np.asarray(view.weights[0, 0] * whole + view.specular_weight * solved["specular"].to_numpy())


def diffusion_value(stack: OpticalStack, view: Readout) -> FloatArray:
    """(W,) what the instrument reads by the dipole: rings in closed form, cones from the radiance at the surface.

    At the surface diffusion's radiance rises towards the normal as 2A + 3µ, A = (1 + F)/(1 − F) (its fluence is
    2A times the net flux, the very boundary condition that puts the image where it is).
    """
    solved = diffusion(stack, mu0=math.cos(view.source.angle_rad))
    specular = solved["specular"].to_numpy()
    share = _cone_share(stack, view, _diffuse_radiance)
    if whole_plane(view) and not view.tally.radius_edges:
        seen = float(view.weights[0, 0]) * solved["reflectance"].to_numpy()
    else:
        layer = stack.layers[0]
        absorption, reduced = reduced_coefficients(layer)
        beyond = np.array(
            [
                dipole_beyond(np.array(view.tally.radius), a, s, float(n), float(above))
                for a, s, n, above in zip(absorption, reduced, layer.n, stack.n_above, strict=True)
            ]
        )
        rings = (beyond[:, :-1] - beyond[:, 1:]) * (1.0 - specular)[:, None]
        seen = rings @ view.weights[0]
    return np.asarray(seen * share + view.specular_weight * specular)


def dipole_beyond(
    radius_mm: FloatArray, absorption: float, reduced_scattering: float, n: float = 1.0, n_above: float = 1.0
) -> FloatArray:
    """Share of the light that entered which leaves farther from the beam than a radius: a'/2 Σ z e^(−µ_eff d)/d.

    The integral of `diffusion.dipole_profile` (Farrell et al. 1992; Jensen et al. 2001) from the radius on; from 0
    it is `dipole_total`.

    >>> from livlab.model.transport.diffusion import dipole_total
    >>> bool(np.isclose(dipole_beyond(np.zeros(1), 0.01, 1.0, 1.4)[0], dipole_total(0.01, 1.0, 1.4)))
    True
    """
    transport = absorption + reduced_scattering
    effective = math.sqrt(3.0 * absorption * transport)
    inside = diffuse_fresnel(n, n_above)
    source = 1.0 / transport
    total = np.zeros(np.shape(radius_mm))
    for z in (source, source * (1.0 + 4.0 / 3.0 * (1.0 + inside) / (1.0 - inside))):
        d = np.hypot(radius_mm, z)
        total = total + np.where(np.isfinite(d), z * np.exp(-effective * d) / d, 0.0)
    return np.asarray(reduced_scattering / transport / 2.0 * total)


def _diffuse_radiance(n: float, n_above: float, mu: FloatArray) -> FloatArray:
    inside = diffuse_fresnel(n, n_above)
    return 2.0 * (1.0 + inside) / (1.0 - inside) + 3.0 * mu


def _cone_share(
    stack: OpticalStack, view: Readout, radiance: Callable[[float, float, FloatArray], FloatArray]
) -> FloatArray:
    """(W,) share of what leaves that leaves within the cone, given the radiance inside by direction."""
    if not view.tally.theta_edges:
        return np.ones(len(stack.wavelength_nm))
    nodes, weights = np.polynomial.legendre.leggauss(64)
    shares = []
    for n, above in zip(stack.layers[0].n, stack.n_above, strict=True):
        flux = []
        for least in (math.cos(view.tally.theta_edges[-1]), 0.0):
            mu = 0.5 * ((1.0 - least) * nodes + 1.0 + least)
            sine = float(above / n) * np.sqrt(1.0 - mu * mu)
            inner = np.sqrt(np.maximum(1.0 - sine * sine, 0.0))
            passed = 1.0 - fresnel(np.full_like(mu, above), np.full_like(mu, n), mu)
            bright = radiance(float(n), float(above), inner)
            flux.append(0.5 * (1.0 - least) * float(weights @ (passed * bright * mu)))
        shares.append(flux[0] / flux[1])
    return np.array(shares)
