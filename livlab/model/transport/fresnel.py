"""Fresnel's equations at plane interfaces of clear dielectrics, and incoherent stacks of them.

Everything is written in the normal components q = n cosθ of the two wave vectors, in a form without
cancellation, so that a match of the indices to 1e-12, grazing light and the critical angle keep their
digits (Born & Wolf 1999, section 1.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.errors import InputError
from livlab.units import FloatArray

Polarisation = Literal["mixed", "s", "p"]
"""`s`, `p`, or `mixed`: unpolarised anew at every interface, as scalar transport takes it."""


def fresnel_amplitudes(
    n_from: ArrayLike, n_to: ArrayLike, mu: ArrayLike
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Amplitude reflection coefficients (r_s, r_p), complex beyond the critical angle.

    r_s = (q₁ − q₂)/(q₁ + q₂), r_p = (n₂² q₁ − n₁² q₂)/(n₂² q₁ + n₁² q₂), q = n cosθ
    (Born & Wolf 1999, section 1.5.2; at normal incidence r_p = −r_s).

    Parameters
    ----------
    n_from, n_to
        Refractive indices before and behind the interface, > 0; they broadcast.
    mu
        Cosine of the angle of incidence, in [0, 1].

    Returns
    -------
    r_s, r_p
        Complex arrays of the broadcast shape.

    Raises
    ------
    InputError
        An index that is not positive and finite, a cosine outside [0, 1].
    """
    n1, n2, c1 = _checked(n_from, n_to, mu)
    q1, q2_squared = n1 * c1, _q2_squared(n1, n2, c1)
    q2 = np.sqrt(q2_squared.astype(np.complex128))
    same = n1 == n2
    # (n₁ − n₂)(n₁ + n₂) in place of q₁² − q₂²: the difference of the indices survives, not its rounding.
    contrast = np.where(same, 0.0, (n1 - n2) * (n1 + n2))
    sine_squared = n1 * n1 * (1.0 - c1) * (1.0 + c1)
    s_sum = np.where(same, 1.0, q1 + q2)
    p_sum = np.where(same, 1.0, n2 * n2 * q1 + n1 * n1 * q2)
    r_s = contrast / s_sum**2
    # n₂⁴ q₁² − n₁⁴ q₂² = (n₂² − n₁²)(n₁² n₂² − s² (n₁² + n₂²)), zero at Brewster's angle.
    r_p = -contrast * (n1 * n1 * n2 * n2 - sine_squared * (n1 * n1 + n2 * n2)) / p_sum**2
    return r_s, r_p


def fresnel_polarised(n_from: ArrayLike, n_to: ArrayLike, mu: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Reflectances (R_s, R_p) = (|r_s|², |r_p|²); exactly 1 beyond the critical angle.

    Arguments, shapes and errors as in `fresnel_amplitudes`.
    """
    n1, n2, c1 = _checked(n_from, n_to, mu)
    r_s, r_p = fresnel_amplitudes(n1, n2, c1)
    total = (n1 != n2) & ((_q2_squared(n1, n2, c1) <= 0.0) | (c1 == 0.0))
    return np.where(total, 1.0, np.abs(r_s) ** 2), np.where(total, 1.0, np.abs(r_p) ** 2)


def fresnel(n_from: ArrayLike, n_to: ArrayLike, mu: ArrayLike) -> FloatArray:
    """Reflectance of unpolarised light, (R_s + R_p)/2 (Born & Wolf 1999, section 1.5.3).

    Arguments, shapes and errors as in `fresnel_amplitudes`.

    >>> float(fresnel(1.0, 1.5, 1.0).round(12))
    0.04
    >>> float(fresnel(1.5, 1.0, 0.5))
    1.0
    """
    r_s, r_p = fresnel_polarised(n_from, n_to, mu)
    return 0.5 * (r_s + r_p)


def refracted_cosine(n_from: ArrayLike, n_to: ArrayLike, mu: ArrayLike) -> FloatArray:
    """Cosine behind the interface by Snell's law; 0 at and beyond the critical angle.

    >>> float(refracted_cosine(1.0, 1.5, 0.5).round(6))
    0.816497
    """
    n1, n2, c1 = _checked(n_from, n_to, mu)
    return np.minimum(np.sqrt(np.maximum(_q2_squared(n1, n2, c1), 0.0)) / n2, 1.0)


def diffuse_fresnel(n_from: float, n_to: float) -> float:
    """Reflectance of an interface for light of equal radiance from all directions: 2 ∫ R(µ) µ dµ.

    From the denser side it holds the totally reflected light; n₁² (1 − r₁₂) = n₂² (1 − r₂₁)
    (Duntley 1942; the F_dr of Jensen et al. 2001 without their polynomial).

    Raises
    ------
    InputError
        An index that is not positive and finite.

    >>> round(diffuse_fresnel(1.0, 1.5), 6), round(diffuse_fresnel(1.5, 1.0), 6)
    (0.091778, 0.596346)
    """
    from livlab.model.transport.quadrature import SAME_INDEX, AngularGrid

    _checked(n_from, n_to, 1.0)
    if abs(n_to - n_from) <= SAME_INDEX * n_from:
        return 0.0
    rare = min(n_from, n_to)
    grid = AngularGrid.of((n_from, n_to), 48, (rare, 1.0))
    shared = grid.active(rare)[1:]
    enters = grid.flux()[shared] @ (1.0 - fresnel(rare, max(n_from, n_to), grid.cosines(rare)[1:]))
    return float(1.0 - enters / (0.5 * n_from * n_from))


def incoherent_stack(
    n: Sequence[float],
    mu0: float = 1.0,
    optical_depth: Sequence[float] | None = None,
    polarisation: Polarisation = "mixed",
) -> tuple[float, float]:
    """Reflectance and transmittance of a stack of plates for light that never scatters.

    All orders of reflection are added as powers: r + t² r' e^(−2τ/µ)/(1 − r r' e^(−2τ/µ)), from the
    lowest interface up (Stokes 1862, plates thick against the coherence length).

    Parameters
    ----------
    n
        Indices from the medium above, through the layers, to the medium below: at least two.
    mu0
        Cosine of incidence in the medium above, in (0, 1].
    optical_depth
        Extinction times thickness of each inner layer, ≥ 0, may be inf; clear layers if omitted.
    polarisation
        `mixed` averages both polarisations at every interface, `s` and `p` keep one throughout.

    Returns
    -------
    reflectance, transmittance
        With the first surface's reflection. They sum to 1 for clear layers.

    Raises
    ------
    InputError
        Fewer than two indices, a depth per layer missing or negative, a bad cosine or index.

    >>> r, t = incoherent_stack([1.0, 1.5, 1.0])
    >>> round(r, 9), round(r + t, 12)
    (0.076923077, 1.0)
    """
    depths = [0.0] * (len(n) - 2) if optical_depth is None else [float(x) for x in optical_depth]
    if len(n) < 2 or len(depths) != len(n) - 2:
        raise InputError.of(
            "optical_depth", len(depths), f"must have {max(len(n) - 2, 0)} entries", "Give one depth an inner layer."
        )
    if any(not x >= 0 for x in depths):
        raise InputError.of("optical_depth", depths, "must be >= 0", "Give depths of at least 0.")
    if not 0 < mu0 <= 1:
        raise InputError.of("mu0", mu0, "must be in (0, 1]", "Give the cosine of incidence above the stack.")
    cosines = [float(mu0), *(float(refracted_cosine(n[0], below, mu0)) for below in n[1:])]
    reflectance, transmittance = 0.0, 1.0
    for k in range(len(n) - 2, -1, -1):
        if k < len(n) - 2:
            mu = cosines[k + 1]
            passed = np.exp(-depths[k] / mu) if mu > 0 else 0.0
            reflectance, transmittance = reflectance * passed**2, transmittance * passed
        r_s, r_p = fresnel_polarised(n[k], n[k + 1], cosines[k])
        r = float({"mixed": 0.5 * (r_s + r_p), "s": r_s, "p": r_p}[polarisation])
        # Cut off from everything below (evanescent there, or totally reflected): nothing enters.
        if r == 1.0 or (k > 0 and cosines[k] == 0.0):
            reflectance, transmittance = 1.0, 0.0
            continue
        bounce = 1.0 - r * reflectance
        reflectance, transmittance = r + (1.0 - r) ** 2 * reflectance / bounce, (1.0 - r) * transmittance / bounce
    return float(reflectance), float(transmittance)


def _q2_squared(n1: FloatArray, n2: FloatArray, c1: FloatArray) -> FloatArray:
    return (n2 - n1) * (n2 + n1) + (n1 * c1) ** 2


def _checked(n_from: ArrayLike, n_to: ArrayLike, mu: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    n1, n2, c1 = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in (n_from, n_to, mu)))
    for what, values, good in (
        ("n_from", n1, np.isfinite(n1) & (n1 > 0)),
        ("n_to", n2, np.isfinite(n2) & (n2 > 0)),
        ("mu", c1, (c1 >= 0) & (c1 <= 1)),
    ):
        if not good.all():
            raise InputError.of(
                what,
                float(values[~good].flat[0]),
                "must be in [0, 1]" if what == "mu" else "must be positive and finite",
                "Mend the value.",
            )
    return n1, n2, c1
