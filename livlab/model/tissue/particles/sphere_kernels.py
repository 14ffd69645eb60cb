"""Compiled inner loops of Lorenz–Mie: nearly matched spheres and amplitudes over many angles.

Kernels use the sign of Bohren & Huffman 1983: time factor exp(−iωt), m = n + ik.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from livlab.core.compiled import compiled
from livlab.units import FloatArray

ComplexArray = NDArray[np.complex128]

_BLOCK = 128


@compiled
def matched_coefficients(contrast: complex, x: float) -> tuple[ComplexArray, ComplexArray]:
    """a_n/(m − 1) and b_n/(m − 1), n = 1 …, of a sphere with m = 1 + contrast (Bohren & Huffman 1983, eq. 4.88).

    With D_n = ψ_n'/ψ_n the numerators are ψ_n(x) [D_n(mx)/m − D_n(x)] and ψ_n(x) [m D_n(mx) − D_n(x)], which
    cancel as m → 1. Here the quotient (D_n(mx) − D_n(x))/(m − 1) itself runs down the recurrence, so nothing
    cancels and m = 1 is an ordinary point.
    """
    m = 1.0 + contrast
    terms = int(x + 4.05 * x ** (1.0 / 3.0) + 2.0)
    start = int(max(float(terms), x * abs(m))) + 25 + int(1.5 * np.sqrt(x * abs(m)))
    log_d = np.empty(terms + 1)
    quotient = np.empty(terms + 1, dtype=np.complex128)
    d = (start + 1.0) / x
    q = -(start + 1.0) / (m * x)
    for n in range(start, 0, -1):
        if n <= terms:
            log_d[n] = d
            quotient[n] = q
        v = d + n / x
        u = d + contrast * q + n / (m * x)
        q = -n / (m * x) + (q - n / (m * x)) / (u * v)
        d = n / x - 1.0 / v
    a = np.empty(terms, dtype=np.complex128)
    b = np.empty(terms, dtype=np.complex128)
    psi_before, psi = np.sin(x), 0.0
    older = np.cos(x)  # ψ_{−1}
    chi_before, chi = np.cos(x), np.cos(x) / x + np.sin(x)
    for n in range(1, terms + 1):
        d = log_d[n]
        # Upwards the recurrence loses ψ_n beyond n = x; the ratio from the downward one does not.
        psi = (2.0 * n - 1.0) / x * psi_before - older if n < x else psi_before / (d + n / x)
        q = quotient[n]
        inner = d + contrast * q
        top_a = psi * (q - d) / m
        low_a = (inner / m + n / x) * chi - chi_before
        a[n - 1] = top_a / (contrast * top_a - 1j * low_a)
        top_b = psi * (m * q + d)
        low_b = (inner * m + n / x) * chi - chi_before
        b[n - 1] = top_b / (contrast * top_b - 1j * low_b)
        older, psi_before = psi_before, psi
        chi_before, chi = chi, (2.0 * n + 1.0) / x * chi - chi_before
    return a, b


@compiled
def intensity(a: ComplexArray, b: ComplexArray, w: FloatArray) -> FloatArray:
    """(|S1|² + |S2|²)/2 at 1 − cos θ = w (Bohren & Huffman 1983, eqs. 4.47, 4.74).

    The sums run over S1 ± S2, whose weights are π_n ± τ_n, for a block of angles at a time.
    """
    out = np.empty(w.size)
    terms = a.size
    pi = np.empty(_BLOCK)
    pi_before = np.empty(_BLOCK)
    plus_re = np.empty(_BLOCK)
    plus_im = np.empty(_BLOCK)
    minus_re = np.empty(_BLOCK)
    minus_im = np.empty(_BLOCK)
    for first in range(0, w.size, _BLOCK):
        count = min(_BLOCK, w.size - first)
        for k in range(count):
            pi[k] = 1.0
            pi_before[k] = 0.0
            plus_re[k] = plus_im[k] = minus_re[k] = minus_im[k] = 0.0
        for i in range(terms):
            n = i + 1.0
            scale = (2.0 * n + 1.0) / (n * (n + 1.0))
            s_re = scale * (a[i].real + b[i].real)
            s_im = scale * (a[i].imag + b[i].imag)
            d_re = scale * (a[i].real - b[i].real)
            d_im = scale * (a[i].imag - b[i].imag)
            grow = (n + 1.0) / n
            for k in range(count):
                p = pi[k]
                s = p - w[first + k] * p
                t = s - pi_before[k]
                tau = n * t - pi_before[k]
                plus = p + tau
                minus = p - tau
                plus_re[k] += s_re * plus
                plus_im[k] += s_im * plus
                minus_re[k] += d_re * minus
                minus_im[k] += d_im * minus
                pi_before[k] = p
                pi[k] = s + grow * t
        for k in range(count):
            out[first + k] = 0.25 * (plus_re[k] ** 2 + plus_im[k] ** 2 + minus_re[k] ** 2 + minus_im[k] ** 2)
    return out
