"""Mie coefficients of spheres much smaller than the wavelength, by power series.

Libraries lose digits there: the numerators of a_n and b_n are differences of nearly equal products. Written
as series in x² the difference can be taken term by term, with the factor m² − 1 outside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from livlab.units import FloatArray

ComplexArray = NDArray[np.complex128]

SMALL_X = 0.1
"""Below this size parameter the series is used …"""
SMALL_MX = 1.0
"""… if |m| x is below this too."""
_ORDERS = 6
_POWERS = 14


class MieCoefficients(NamedTuple):
    """Mie coefficients divided by a common factor: a_n = scale · a[…, n − 1], b_n alike.

    The factor is apart because it holds what would underflow (x³) or vanish (m² − 1).
    """

    a: ComplexArray
    b: ComplexArray
    scale: ComplexArray


def small_coefficients(m: ComplexArray, x: FloatArray) -> MieCoefficients:
    """Coefficients a_n, b_n, n = 1 … 6, for x < 0.1 and |m| x < 1 (Bohren & Huffman 1983, eqs. 4.56, 4.57).

    With t = x², ψ_n(x) = x^(n+1) f(t)/(2n+1)!!, ψ_n'(x) = xⁿ h(t)/(2n+1)!!, χ_n = (2n−1)!! x^(−n) k(t) and
    χ_n' = (2n−1)!! x^(−n−1) l(t), and with f(m²t) = f(t) + (m² − 1) F, h(m²t) = h(t) + (m² − 1) H,

        a_n = A/(A − iC),  A = (m² − 1) x^(2n+1) [f h + m² F h − f H]/((2n+1)!! (2n−1)!!),
                           C = m² f(m²t) l − h(m²t) k

    and the same for b_n with F h − f H and f(m²t) l − h(m²t) k. Checked against 50 digits: 1e-14.

    Parameters
    ----------
    m, x
        (N,) relative index n + ik and size parameter.

    Returns
    -------
    MieCoefficients
        a, b of shape (N, 6); scale (N,) is (m² − 1) x³.
    """
    contrast = (m - 1.0) * (m + 1.0)
    square = 1.0 + contrast
    t = x * x
    shape = (*np.shape(x), _ORDERS)
    a, b = np.empty(shape, dtype=np.complex128), np.empty(shape, dtype=np.complex128)
    odd = 1.0  # (2n − 1)!!
    for n in range(1, _ORDERS + 1):
        next_odd = odd * (2 * n + 1)
        f1 = np.ones_like(t)
        h1 = (n + 1.0) * f1
        k1, l1 = f1.copy(), -float(n) * f1
        big_f = np.zeros_like(square)
        big_h = np.zeros_like(square)
        term, chi_term = np.ones_like(t), np.ones_like(t)
        power_sum = np.zeros_like(square)  # (m^(2k) − 1)/(m² − 1) = 1 + m² + … + m^(2k−2)
        for k in range(1, _POWERS + 1):
            term = term * (-0.5 * t) / (k * (2 * n + 2 * k + 1))
            chi_term = chi_term * (-0.5 * t) / (k * (2 * k - 1 - 2 * n))
            power_sum = 1.0 + square * power_sum
            f1, h1 = f1 + term, h1 + (n + 1 + 2 * k) * term
            k1, l1 = k1 + chi_term, l1 + (2 * k - n) * chi_term
            big_f, big_h = big_f + term * power_sum, big_h + (n + 1 + 2 * k) * term * power_sum
        f2, h2 = f1 + contrast * big_f, h1 + contrast * big_h
        weight = x ** (2 * n - 2) / (next_odd * odd)
        scale = contrast * x**3
        for out, top, low in (
            (a, weight * (f1 * h1 + square * big_f * h1 - f1 * big_h), square * f2 * l1 - h2 * k1),
            (b, weight * (big_f * h1 - f1 * big_h), f2 * l1 - h2 * k1),
        ):
            out[..., n - 1] = top / (scale * top - 1j * low)
        odd = next_odd
    return MieCoefficients(a, b, scale)
