"""Diffusion's dipole: a half-space lit by a narrow beam, where scattering far outweighs absorption.

Farrell, Patterson & Wilson 1992 and Jensen et al. 2001 (Nunes 2019, eqs. 5.4, 5.5) write the same field: one
source a transport path below the surface and its negative image above. Distances are √(r² + z²); eq. 5.5 as
printed in the thesis, with a minus sign, has no real value near the source.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.fresnel import diffuse_fresnel, fresnel
from livlab.model.transport.moments import reduced_coefficients
from livlab.units import FloatArray

LEAST_REDUCED_ALBEDO = 0.98
"""Where µ_s'/(µ_a + µ_s') is at least this, totals are within 3 % of transport for n from 1 to 1.5 and g from
0 to 0.9 (at 0.95 the error reaches 11 %, at 0.9 27 %, and at 0.5 it exceeds 100 %)."""


def dipole_total(
    absorption: ArrayLike, reduced_scattering: ArrayLike, n: float = 1.0, n_above: float = 1.0
) -> FloatArray:
    """Share of the light that entered which leaves again: a'/2 (1 + e^(−4A√(3(1−a'))/3)) e^(−√(3(1−a'))).

    The integral of `dipole_profile` over the plane (Farrell et al. 1992; Jensen et al. 2001), with
    A = (1 + F)/(1 − F) of the exact diffuse Fresnel reflectance F inside. It is a share of the light that
    entered: times 1 − R(µ₀) of the surface for incident light.

    Parameters
    ----------
    absorption, reduced_scattering
        µ_a and µ_s' in 1/mm, ≥ 0; they broadcast.
    n, n_above
        Indices of the half-space and of the medium above.

    Raises
    ------
    InputError
        A negative or infinite coefficient, both 0 at once, or a bad index.

    >>> float(dipole_total(0.001, 1.0, 1.38).round(4))
    0.8497
    """
    absorption, reduced = _checked(absorption, reduced_scattering)
    albedo = reduced / (absorption + reduced)
    root = np.sqrt(3.0 * absorption / (absorption + reduced))
    return 0.5 * albedo * (1.0 + np.exp(-4.0 / 3.0 * _mismatch(n, n_above) * root)) * np.exp(-root)


def dipole_profile(
    radius_mm: ArrayLike, absorption: ArrayLike, reduced_scattering: ArrayLike, n: float = 1.0, n_above: float = 1.0
) -> FloatArray:
    """Light that leaves at a distance from a narrow beam, per area and per light that entered, in 1/mm².

    R(r) = a'/(4π) Σ z (1 + µ_eff d) e^(−µ_eff d)/d³ over source and image, d = √(r² + z²), z = 1/µ_t' and
    z + 4AD, D = 1/(3µ_t') (Farrell et al. 1992; Jensen et al. 2001, eq. 4; Nunes 2019, eq. 5.4).
    Diffusion holds beyond about one transport path 1/(µ_a + µ_s') from the beam.

    Parameters
    ----------
    radius_mm
        Distances ≥ 0; all arguments broadcast.
    absorption, reduced_scattering, n, n_above
        As in `dipole_total`.

    Raises
    ------
    InputError
        As `dipole_total`, and a negative or infinite radius.
    """
    radius = np.asarray(radius_mm, dtype=np.float64)
    if not (np.isfinite(radius) & (radius >= 0)).all():
        raise InputError.of("radius_mm", radius, "must be finite and >= 0", "Give distances from the beam.")
    absorption, reduced = _checked(absorption, reduced_scattering)
    transport = absorption + reduced
    effective = np.sqrt(3.0 * absorption * transport)
    source = 1.0 / transport
    image = source * (1.0 + 4.0 / 3.0 * _mismatch(n, n_above))
    total = np.zeros(np.broadcast_shapes(radius.shape, transport.shape))
    for z in (source, image):
        d = np.hypot(radius, z)
        total = total + z * (1.0 + effective * d) * np.exp(-effective * d) / d**3
    return reduced / transport / (4.0 * math.pi) * total


def diffusion(stack: OpticalStack, *, mu0: float = 1.0) -> xr.Dataset:
    """Total reflectance of one homogeneous half-space by the dipole, and where it may be believed.

    Parameters
    ----------
    stack
        One layer only, infinite or at least 12 penetration depths thick at each wavelength.
    mu0
        Cosine of incidence, in (0, 1]: it decides what the surface reflects, no more.

    Returns
    -------
    xr.Dataset
        Dimension wavelength: `specular`, `reflectance` (without it), `absorbed` (the rest), `valid`
        (reduced albedo at least `LEAST_REDUCED_ALBEDO`), `reduced_albedo`.

    Raises
    ------
    InputError
        Several layers, a layer that is too thin, no absorption nor scattering, or a bad cosine.
    """
    if len(stack.layers) != 1:
        raise InputError.of(
            "layers", len(stack.layers), "the dipole knows one homogeneous half-space", "Use adding_doubling."
        )
    if not 0 < mu0 <= 1:
        raise InputError.of("mu0", mu0, "must be in (0, 1]", "Give the cosine of incidence above the stack.")
    layer = stack.layers[0]
    absorption, reduced = reduced_coefficients(layer)
    _checked(absorption, reduced)
    # An image of the beam at 12 penetration depths returns e⁻²⁴ of what the dipole says.
    depth = np.sqrt(3.0 * absorption * (absorption + reduced)) * layer.thickness_mm if absorption.all() else 0.0
    if not (math.isinf(layer.thickness_mm) or np.min(depth) >= 12.0):
        raise InputError.of(
            f"{layer.name}.thickness_mm", layer.thickness_mm, "is too thin for a half-space", "Use adding_doubling."
        )
    specular = fresnel(stack.n_above, layer.n, mu0)
    inside = np.array(
        [
            float(dipole_total(a, s, float(n), float(above)))
            for a, s, n, above in zip(absorption, reduced, layer.n, stack.n_above, strict=True)
        ]
    )
    albedo = reduced / (absorption + reduced)
    share = {"units": "1"}
    return xr.Dataset(
        {
            "reflectance": ("wavelength", (1.0 - specular) * inside, share),
            "specular": ("wavelength", specular, share),
            "absorbed": ("wavelength", (1.0 - specular) * (1.0 - inside), share),
            "reduced_albedo": ("wavelength", albedo, share),
            "valid": ("wavelength", albedo >= LEAST_REDUCED_ALBEDO),
        },
        coords={"wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"})},
        attrs={
            "solver": "diffusion",
            "mu0": mu0,
            "domain": f"one half-space, reduced albedo at least {LEAST_REDUCED_ALBEDO}: within 3 % of transport",
            "notes": "; ".join(stack.notes),
        },
    )


def _mismatch(n: float, n_above: float) -> float:
    """A = (1 + F)/(1 − F), the reach of the extrapolated surface in units of 2D."""
    inside = diffuse_fresnel(n, n_above)
    return (1.0 + inside) / (1.0 - inside)


def _checked(absorption: ArrayLike, reduced: ArrayLike) -> tuple[FloatArray, FloatArray]:
    a, s = np.broadcast_arrays(np.asarray(absorption, dtype=np.float64), np.asarray(reduced, dtype=np.float64))
    for what, values in (("absorption", a), ("reduced_scattering", s)):
        bad = ~(np.isfinite(values) & (values >= 0))
        if bad.any():
            raise InputError.of(what, float(values[bad].flat[0]), "must be finite and >= 0", "Give 1/mm.")
    if (a + s == 0).any():
        raise InputError.of("absorption + reduced_scattering", 0.0, "must be > 0", "A clear medium does not diffuse.")
    return a, s
