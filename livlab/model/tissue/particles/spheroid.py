"""Geometric attenuation by spheroidal cells: the hepatocyte of Nunes 2019, eq. 6.16, 6.17 and 6.19."""

from __future__ import annotations

import math

import numpy as np

from livlab.errors import InputError
from livlab.units import FloatArray, per_cm_to_per_mm, per_mm_to_per_cm


def surface_term(a: float, b: float) -> float:
    """Shape term a/b + asin(c)/c of a spheroid, with c = √(1 − a²/b²) (Nunes 2019, eq. 6.16, 6.17).

    A spheroid of semi-axes a, a, b has surface over volume 3/(2a) times this term. For b < a (a flat spheroid) c is
    imaginary and asin(c)/c continues to asinh(s)/s with s = √(a²/b² − 1); at a = b both are 1 and the term is 2.

    Parameters
    ----------
    a
        The two equal axes, > 0 (any unit of length).
    b
        The third axis, > 0, in the same unit.

    Raises
    ------
    InputError
        An axis that is not a positive finite number.

    Examples
    --------
    >>> surface_term(20.0, 20.0)
    2.0
    >>> round(surface_term(20.0, 30.0), 6)
    1.795079
    """
    for name, value in (("a", a), ("b", b)):
        if not (value > 0 and math.isfinite(value)):
            raise InputError.of(f"spheroid.{name}", value, "must be a finite length > 0", "Give the axis its length.")
    ratio = a / b
    # (1 − ratio)(1 + ratio) keeps its digits near a sphere, where 1 − ratio² loses them.
    square = (1.0 - ratio) * (1.0 + ratio)
    s = math.sqrt(abs(square))
    if s == 0.0:
        factor = 1.0
    elif square > 0:
        factor = math.atan2(s, ratio) / s
    else:
        factor = math.asinh(s) / s
    return ratio + factor


def attenuation(a_mm: float, b_mm: float, fraction: float) -> float:
    """Geometric attenuation of a suspension of spheroids, in 1/mm (Nunes 2019, eq. 6.16; Kimmel & Baranoski 2007).

    σ_t = 3/(2a) · (a/b + asin(c)/c) · f/4: fraction times surface over four volumes, the mean projected area of a
    convex body (Cauchy). Right when a and b are semi-axes; the thesis puts diameters in and gets half of it.

    Parameters
    ----------
    a_mm, b_mm
        Axes in mm, > 0.
    fraction
        Volume fraction, 0–1.

    Raises
    ------
    InputError
        An axis that is not positive, or a fraction outside 0–1.

    Examples
    --------
    >>> round(attenuation(0.020, 0.030, 0.8) * 10, 1), round(attenuation(0.010, 0.015, 0.8) * 10, 1)
    (269.3, 538.5)
    """
    if not 0.0 <= fraction <= 1.0:
        raise InputError.of("fraction", fraction, "must be within [0, 1]", "Give a volume fraction.")
    return 1.5 / a_mm * surface_term(a_mm, b_mm) * fraction / 4.0


def penalised_rate(sigma_per_mm: FloatArray) -> FloatArray:
    """Rate in 1/mm of the hepatocyte's penalised draw d' = −log10(σ_t + 1) ln ξ (Nunes 2019, eq. 6.19).

    The draw is exponential with rate 1/log10(σ_t + 1), σ_t and the rate in 1/cm. It falls as σ_t grows: more cells
    scatter less. σ_t = 0 never interacts, so its rate is 0 and not the formula's infinity (nor is anything below
    1e-300 1/cm, whose rate no float holds).

    Parameters
    ----------
    sigma_per_mm
        σ_t ≥ 0 in 1/mm, any shape.

    Raises
    ------
    InputError
        A σ_t that is negative or not finite.

    Examples
    --------
    >>> penalised_rate(np.array([0.0, 0.9, 9.9]))
    array([0.  , 0.1 , 0.05])
    """
    sigma = per_mm_to_per_cm(np.asarray(sigma_per_mm, dtype=float))
    bad = ~(np.isfinite(sigma) & (sigma >= 0))
    if bad.any():
        raise InputError.of("sigma_t", float(sigma[bad].flat[0]), "must be finite and ≥ 0", "Mend the attenuation.")
    met = sigma > 1e-300
    length_cm = np.log1p(np.where(met, sigma, 1.0)) / math.log(10.0)
    return per_cm_to_per_mm(np.where(met, 1.0 / length_cm, 0.0))
