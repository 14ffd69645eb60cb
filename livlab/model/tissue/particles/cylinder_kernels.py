"""Compiled coefficients of an infinite circular cylinder at any incidence.

The determinants of Bohren & Huffman 1983, p. 202, cancel at grazing incidence, near m = 1 and near
m = cos ζ. They are rewritten here in quantities that stay of order one. With ξ = x sin ζ,
η² = x² (m² − cos² ζ), c = cos ζ and, for each order n,

    M1 = ξ J_n'(ξ)/J_n(ξ),  M2 = η J_n'(η)/J_n(η),  h = ξ H_n'(ξ)/H_n(ξ) = θ − n,  R = J_n(ξ)/H_n(ξ),
    μ = (M2 − M1)/(η² − ξ²),  ν = (n − M2)/η²,  q = ξ²/η²,  1 − q = x² (m² − 1)/η²,

the coefficients are

    b_nI  = R (1 − q) {(h − q M2) [m² ξ² μ − c² M1] + n² c² (1 − q)}/Δ
    a_nII = R (1 − q) {(M1 − ξ² μ) (m² q M2 − h) + n² c² (1 − q)}/Δ
    a_nI  = −b_nII = 2 n c (1 − q)/(π H_n(ξ)² Δ)
    Δ     = (h − q M2) (m² q M2 − h) + n² c² (1 − q)²

Δ is summed without its leading terms, which cancel as ξ → 0. M1, M2, μ and ν run down, θ runs up. Where
|q| > 1 (η → 0, possible for m < 1 only) the same numbers are formed with one factor η² taken out.
Time factor exp(−iωt), m = n + ik.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from livlab.core.compiled import compiled
from livlab.units import FloatArray

ComplexArray = NDArray[np.complex128]


def bessel_pair(xi: FloatArray) -> FloatArray:
    """(N, 4) J0, Y0, J1, Y1 at ξ, as the kernels want them; 1, 0, 0, 0 at ξ = 0, where no kernel asks."""
    from scipy.special import j0, j1, y0, y1

    safe = np.where(xi > 0.0, xi, 1.0)
    return np.stack([j0(safe), y0(safe), j1(safe), y1(safe)], axis=-1)


@compiled
def orders(xi: float) -> int:
    """Highest order kept: the coefficients fall faster than exponentially beyond ξ."""
    if xi < 1e-3:
        return 4
    return int(xi + 6.0 * xi ** (1.0 / 3.0) + 8.0)


@compiled
def coefficients(
    contrast: complex,
    x: float,
    sine: float,
    cosine: float,
    bessel: FloatArray,
    b1: ComplexArray,
    a1: ComplexArray,
    a2: ComplexArray,
) -> int:
    """Fill b_nI, a_nI, a_nII for n = 0 … N and return N.

    `contrast` is m² − 1; `bessel` holds J0, Y0, J1, Y1 at ξ = x sin ζ.
    """
    square = 1.0 + contrast
    xi = x * sine
    y1 = xi * xi
    tau = x * x * contrast
    y2 = tau + y1
    top = orders(xi)
    size = np.sqrt(abs(y2))
    start = int(max(float(top), xi, size)) + 25 + int(1.5 * np.sqrt(max(xi, size)))
    m1s = np.empty(top + 1)
    mus = np.empty(top + 1, dtype=np.complex128)
    m2s = np.empty(top + 1, dtype=np.complex128)
    nus = np.empty(top + 1, dtype=np.complex128)
    m1 = float(start)
    m2 = complex(start)
    mu = complex(-0.5 / (start + 1.0))
    for n in range(start, 0, -1):
        low1 = n + m1
        low2 = n + m2
        mu = -(low1 - y1 * mu) / (low1 * low2)
        m1 = n - 1.0 - y1 / low1
        m2 = n - 1.0 - y2 / low2
        # The recurrence for μ loses digits where M1 and M2 lie far apart; there their difference has them.
        if abs(m2 - m1) > 0.05 * max(abs(m1), abs(m2)):
            mu = (m2 - m1) / tau
        if n - 1 <= top:
            m1s[n - 1] = m1
            m2s[n - 1] = m2
            mus[n - 1] = mu
            nus[n - 1] = 1.0 / low2
    j_before = 0.0
    j = bessel[0]
    inverse_h = 1.0 / complex(bessel[0], bessel[1])
    theta = 0j
    wide = abs(y1) > abs(y2)  # |q| > 1
    q = 0j if wide else y1 / y2
    inverse_q = y2 / y1 if wide else 0j
    for n in range(top + 1):
        m1 = m1s[n]
        m2 = m2s[n]
        mu = mus[n]
        nu = nus[n]
        if n == 0:
            h = -xi * complex(bessel[2], bessel[3]) * inverse_h
            r = j * inverse_h
            nu1 = 1.0 / (1.0 + m1s[1])
            if wide:
                b1[0] = r * tau * (square * (mu + nu) + m1 / (x * x)) / (-square * y1 * nu - h)
                a2[0] = -r * tau * (nu + mu) / (h + y1 * nu)
            else:
                b1[0] = r * tau * q * (square * mu + cosine * cosine * nu1) / (square * q * m2 - h)
                a2[0] = -r * tau * q * (nu1 + mu) / (h - q * m2)
            a1[0] = 0.0
            continue
        if n == 1:
            theta = xi * complex(bessel[0], bessel[1]) / complex(bessel[2], bessel[3])
            j_before, j = j, bessel[2]
        else:
            theta = y1 / (2.0 * (n - 1.0) - theta)
            after = 2.0 * (n - 1.0) / xi * j - j_before if n < xi else j * xi / (n + m1)
            j_before, j = j, after
        inverse_h = inverse_h * theta / xi
        h = theta - n
        r = j * inverse_h
        nc = n * cosine
        turn = square * y1 * mu - cosine * cosine * m1
        if wide:
            rest = square * nu * (n + m2) - n * n / (x * x)
            share = inverse_q - 1.0
            delta = inverse_q * (theta * (2.0 * n - theta) - (n * sine) ** 2)
            delta += h * m2 * (1.0 + square) - 2.0 * nc * nc - (n * sine) ** 2 + square * y1 * nu * (n + m2)
            inner_b = h * turn + nc * nc - y1 * (m2 * (square * mu + m1 / (x * x)) + rest)
            inner_a = -h * (m1 - y1 * mu) + nc * nc - y1 * (square * mu * m2 + rest)
        else:
            share = tau / y2
            delta = theta * (2.0 * n - theta) + n * n * (q * q - 2.0 * q - (sine * share) ** 2)
            delta += q * m2 * (h * (1.0 + square) - square * q * m2)
            inner_b = (h - q * m2) * turn + nc * nc * share
            inner_a = (m1 - y1 * mu) * (square * q * m2 - h) + nc * nc * share
        b1[n] = r * share * inner_b / delta
        a2[n] = r * share * inner_a / delta
        a1[n] = 2.0 / np.pi * nc * share * inverse_h * inverse_h / delta
    return top


@compiled
def efficiencies(
    contrast: ComplexArray, x: FloatArray, sine: FloatArray, cosine: FloatArray, bessel: FloatArray
) -> FloatArray:
    """Rows Q_ext I, II, Q_sca I, II and Q_sca ⟨cos φ⟩ I, II, φ being the azimuth on the cone of scattering.

    Bohren & Huffman 1983, eqs. 8.36, 8.37; the last two by ∫ cos φ |Σ c_n e^(inφ)|² dφ = 2π Re Σ c_n c*_(n+1).
    """
    out = np.zeros((x.size, 6))
    room = 0
    for k in range(x.size):
        room = max(room, orders(x[k] * sine[k]) + 1)
    b1 = np.empty(room, dtype=np.complex128)
    a1 = np.empty(room, dtype=np.complex128)
    a2 = np.empty(room, dtype=np.complex128)
    for k in range(x.size):
        if sine[k] <= 0.0:
            continue
        top = coefficients(contrast[k], x[k], sine[k], cosine[k], bessel[k], b1, a1, a2)
        ext1 = b1[0].real
        ext2 = a2[0].real
        sca1 = abs(b1[0]) ** 2
        sca2 = abs(a2[0]) ** 2
        turn1 = (b1[0] * b1[1].conjugate()).real
        turn2 = (a2[0] * a2[1].conjugate()).real
        for n in range(1, top + 1):
            mixed = abs(a1[n]) ** 2
            ext1 += 2.0 * b1[n].real
            ext2 += 2.0 * a2[n].real
            sca1 += 2.0 * (abs(b1[n]) ** 2 + mixed)
            sca2 += 2.0 * (abs(a2[n]) ** 2 + mixed)
            if n < top:
                crossed = (a1[n] * a1[n + 1].conjugate()).real
                turn1 += (b1[n] * b1[n + 1].conjugate()).real + crossed
                turn2 += (a2[n] * a2[n + 1].conjugate()).real + crossed
        scale = 2.0 / x[k]
        out[k, 0] = scale * ext1
        out[k, 1] = scale * ext2
        out[k, 2] = scale * sca1
        out[k, 3] = scale * sca2
        out[k, 4] = 2.0 * scale * turn1
        out[k, 5] = 2.0 * scale * turn2
    return out


@compiled
def coefficient_table(
    contrast: complex, x: float, sine: FloatArray, cosine: FloatArray, bessel: FloatArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """b_nI, a_nI, a_nII, each of shape (angles, orders), padded with zeros."""
    room = orders(x * sine.max()) + 1
    b1 = np.zeros((sine.size, room), dtype=np.complex128)
    a1 = np.zeros((sine.size, room), dtype=np.complex128)
    a2 = np.zeros((sine.size, room), dtype=np.complex128)
    for k in range(sine.size):
        if sine[k] > 0.0:
            coefficients(contrast, x, sine[k], cosine[k], bessel[k], b1[k], a1[k], a2[k])
    return b1, a1, a2
