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

from typing import NamedTuple

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


class _Incidence(NamedTuple):
    """What all orders share: m², and ξ² = y1, η² = y2 and their difference τ, at sin ζ and cos ζ.

    Where |q| > 1, `wide`, `q` is its inverse.
    """

    square: complex
    x: float
    sine: float
    cosine: float
    y1: float
    y2: complex
    tau: complex
    wide: bool
    q: complex


class _Ratios(NamedTuple):
    """M1, M2, μ and ν of one order."""

    m1: float
    m2: complex
    mu: complex
    nu: complex


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
    xi = x * sine
    y1 = xi * xi
    tau = x * x * contrast
    y2 = tau + y1
    wide = abs(y1) > abs(y2)
    at = _Incidence(
        square=1.0 + contrast, x=x, sine=sine, cosine=cosine, y1=y1, y2=y2, tau=tau, wide=wide,
        q=y2 / y1 if wide else y1 / y2,
    )  # fmt: skip
    top = orders(xi)
    m1s, m2s, mus, nus = _downward(at, xi, top)
    j_before = 0.0
    j = bessel[0]
    inverse_h = 1.0 / complex(bessel[0], bessel[1])
    h = -xi * complex(bessel[2], bessel[3]) * inverse_h
    first = _Ratios(m1s[0], m2s[0], mus[0], nus[0])
    b1[0], a2[0] = _lowest(at, first, 1.0 / (1.0 + m1s[1]), h, j * inverse_h)
    a1[0] = 0.0
    theta = 0j
    for n in range(1, top + 1):
        if n == 1:
            theta = xi * complex(bessel[0], bessel[1]) / complex(bessel[2], bessel[3])
            j_before, j = j, bessel[2]
        else:
            theta = y1 / (2.0 * (n - 1.0) - theta)
            after = 2.0 * (n - 1.0) / xi * j - j_before if n < xi else j * xi / (n + m1s[n])
            j_before, j = j, after
        inverse_h = inverse_h * theta / xi
        inner_b, inner_a, share, delta = _brackets(at, _Ratios(m1s[n], m2s[n], mus[n], nus[n]), n, theta)
        r = j * inverse_h
        b1[n] = r * share * inner_b / delta
        a2[n] = r * share * inner_a / delta
        a1[n] = 2.0 / np.pi * (n * cosine) * share * inverse_h * inverse_h / delta
    return top


@compiled
def _downward(at: _Incidence, xi: float, top: int) -> tuple[FloatArray, ComplexArray, ComplexArray, ComplexArray]:
    """M1, M2, μ and ν for n = 0 … N, by recurrences that run down from far beyond N."""
    y1, y2, tau = at.y1, at.y2, at.tau
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
    return m1s, m2s, mus, nus


@compiled
def _lowest(at: _Incidence, of: _Ratios, nu1: float, h: complex, r: complex) -> tuple[complex, complex]:
    """b_0I and a_0II; `nu1` is 1/(1 + M1) of order 1."""
    square, x, tau, y1 = at.square, at.x, at.tau, at.y1
    m1, m2, mu, nu = of.m1, of.m2, of.mu, of.nu
    if at.wide:
        b = r * tau * (square * (mu + nu) + m1 / (x * x)) / (-square * y1 * nu - h)
        return b, -r * tau * (nu + mu) / (h + y1 * nu)
    q = at.q
    b = r * tau * q * (square * mu + at.cosine * at.cosine * nu1) / (square * q * m2 - h)
    return b, -r * tau * q * (nu1 + mu) / (h - q * m2)


@compiled
def _brackets(at: _Incidence, of: _Ratios, n: int, theta: complex) -> tuple[complex, complex, complex, complex]:
    """The braces of b_nI and a_nII, 1 − q and Δ, n > 0; where |q| > 1 all with η² taken out as the module says."""
    square, x, sine, cosine, y1 = at.square, at.x, at.sine, at.cosine, at.y1
    m1, m2, mu, nu = of
    h = theta - n
    nc = n * cosine
    turn = square * y1 * mu - cosine * cosine * m1
    if at.wide:
        inverse_q = at.q
        rest = square * nu * (n + m2) - n * n / (x * x)
        share = inverse_q - 1.0
        delta = inverse_q * (theta * (2.0 * n - theta) - (n * sine) ** 2)
        delta += h * m2 * (1.0 + square) - 2.0 * nc * nc - (n * sine) ** 2 + square * y1 * nu * (n + m2)
        inner_b = h * turn + nc * nc - y1 * (m2 * (square * mu + m1 / (x * x)) + rest)
        inner_a = -h * (m1 - y1 * mu) + nc * nc - y1 * (square * mu * m2 + rest)
    else:
        q = at.q
        share = at.tau / at.y2
        delta = theta * (2.0 * n - theta) + n * n * (q * q - 2.0 * q - (sine * share) ** 2)
        delta += q * m2 * (h * (1.0 + square) - square * q * m2)
        inner_b = (h - q * m2) * turn + nc * nc * share
        inner_a = (m1 - y1 * mu) * (square * q * m2 - h) + nc * nc * share
    return inner_b, inner_a, share, delta


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
