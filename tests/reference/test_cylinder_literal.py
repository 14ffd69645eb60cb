"""Infinite cylinders against printed values, determinants in 50 digits, and Maxwell's boundary conditions solved."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import h1vp, hankel1, jv, jvp

from livlab.model.tissue.particles.cylinder import cylinder, cylinder_mean
from livlab.model.tissue.particles.cylinder_kernels import bessel_pair, coefficient_table

Coefficients = tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]


def ours(m: complex, x: float, zeta: float) -> Coefficients:
    """b_nI, a_nI, a_nII for m = n + ik."""
    sine, cosine = np.sin([zeta]), np.cos([zeta])
    b1, a1, a2 = coefficient_table(complex((m - 1) * (m + 1)), x, sine, cosine, bessel_pair(x * sine))
    return b1[0], a1[0], a2[0]


def determinants(m: complex, x: float, zeta: float, terms: int) -> Coefficients:
    """Bohren & Huffman 1983, p. 202, as printed, in 50 digits."""
    with mp.workdps(50):
        inside, size, c = mp.mpc(m), mp.mpf(x), mp.cos(mp.mpf(zeta))
        xi, eta = size * mp.sin(mp.mpf(zeta)), size * mp.sqrt(inside**2 - c**2)
        rows = []
        for n in range(terms):
            j, h, k = mp.besselj(n, xi), mp.hankel1(n, xi), mp.besselj(n, eta)
            dj = (mp.besselj(n - 1, xi) - mp.besselj(n + 1, xi)) / 2
            dh = (mp.hankel1(n - 1, xi) - mp.hankel1(n + 1, xi)) / 2
            dk = (mp.besselj(n - 1, eta) - mp.besselj(n + 1, eta)) / 2
            tilt = n * c * eta * k * (xi**2 / eta**2 - 1)
            a = 1j * xi * (xi * dk * j - eta * k * dj)
            b = xi * (inside**2 * xi * dk * j - eta * k * dj)
            cc, d = tilt * j, tilt * h
            v = xi * (inside**2 * xi * dk * h - eta * k * dh)
            w = 1j * xi * (eta * k * dh - xi * dk * h)
            low = w * v + 1j * d * d
            rows.append(((w * b + 1j * d * cc) / low, (cc * v - b * d) / low, -(a * v - 1j * cc * d) / low))
        b1, a1, a2 = (np.array([complex(r[k]) for r in rows]) for k in range(3))
        return b1, a1, a2


def boundary(m: complex, x: float, zeta: float, terms: int) -> Coefficients:
    """E_z, H_z, E_φ, H_φ continuous at the surface, four unknowns an order; k = 1 outside, radius x.

    E_φ = (i/κ²)(i n k_z/ρ E_z − ∂_ρ H_z), H_φ = (i/κ²)(i n k_z/ρ H_z + ε ∂_ρ E_z) for fields exp(i(nφ + k_z z)).
    """
    kz = math.cos(zeta)
    outer, inner = math.sin(zeta), np.sqrt(complex(m) ** 2 - kz**2)
    out = np.zeros((3, terms), dtype=complex)
    for n in range(terms):
        j, dj = jv(n, outer * x), jvp(n, outer * x)
        h, dh = hankel1(n, outer * x), h1vp(n, outer * x)
        k, dk = jv(n, inner * x), jvp(n, inner * x)
        cross_out, cross_in = 1j * n * kz / x / outer**2, 1j * n * kz / x / inner**2
        # unknowns: scattered E_z, H_z, internal E_z, H_z
        matrix = np.array(
            [
                [h, 0, -k, 0],
                [0, h, 0, -k],
                [cross_out * h, -dh / outer, -cross_in * k, dk / inner],
                [dh / outer, cross_out * h, -(complex(m) ** 2) * dk / inner, -cross_in * k],
            ]
        )
        tm = np.linalg.solve(matrix, -np.array([j, 0, cross_out * j, dj / outer]))
        te = np.linalg.solve(matrix, -np.array([0, j, -dj / outer, cross_out * j]))
        out[:, n] = -tm[0], abs(tm[1]), -te[1]
    return out[0], out[1], out[2]


@pytest.mark.parametrize("m", [1.5 / 1.35, 1.5, 0.75, 1.33 + 0.05j, 2.5 + 1j])
@pytest.mark.parametrize("x", [0.3, 2.0, 12.0])
@pytest.mark.parametrize("zeta", [0.15, 0.8, 1.4, 0.5 * math.pi])
def test_boundary_conditions(m: complex, x: float, zeta: float) -> None:
    got, exact = ours(m, x, zeta), boundary(m, x, zeta, 8)
    scale = max(float(np.abs(part).max()) for part in exact)
    for a, b, size_only in zip(got, exact, (False, True, False), strict=True):
        n = min(a.size, b.size)
        left = np.abs(a[:n]) if size_only else a[:n]
        assert np.abs(left - b[:n]).max() <= 1e-9 * scale


@pytest.mark.parametrize("m", [1.5 / 1.35, 1.5, 0.5, 0.75, 0.9999, 1.0 + 1e-7, 1.0 + 1e-3j, 1.5 + 0.1j, 0.05 + 3j])
@pytest.mark.parametrize(
    ("x", "zeta"), [(1e-6, 1.2), (1e-6, 1e-6), (1e-3, 0.5), (1.0, math.pi / 3), (5.2, 1e-6), (5.2, 0.01), (20.3, 0.735)]
)
def test_determinants_in_50_digits(m: complex, x: float, zeta: float) -> None:
    got = ours(m, x, zeta)
    exact = determinants(m, x, zeta, min(got[0].size, 12))
    scale = max(float(np.abs(part).max()) for part in exact)
    for a, b in zip(got, exact, strict=True):
        assert np.abs(a[: b.size] - b).max() <= 1e-11 * scale


def test_order_far_above_the_argument_inside() -> None:
    # η ≪ n ≪ ξ: the recurrence for the difference of logarithmic derivatives alone loses eight digits here.
    got, exact = ours(0.75, 70.0, 0.735), determinants(0.75, 70.0, 0.735, 40)
    for a, b in zip(got, exact, strict=True):
        assert np.abs(a[:40] - b).max() <= 1e-11


def test_rayleigh_1918() -> None:
    """Rayleigh, Phil. Mag. 36:365, 1918 (Scientific Papers VI, p. 560): m = 1.5, x = 2.4, field along the axis.

    He prints (2/π) i b̄_n, twice that for n > 0, and the sums over even and odd n, from five-figure tables.
    """
    b1, _, _ = ours(1.5, 2.4, 0.5 * math.pi)
    terms = (2.0 / math.pi) * 1j * np.conj(b1) * np.where(np.arange(b1.size) == 0, 1.0, 2.0)
    found = [complex(abs(t.real), abs(t.imag)) for t in terms]
    printed = [0.26905 + 0.48842j, 0.39906 + 1.13268j, 0.57166 + 0.91676j, 0.13448 + 0.01436j]
    for a, b in zip(found, printed, strict=False):
        assert abs(a - b) <= 5e-5
    even, odd = sum(found[::2]), sum(found[1::2])
    assert even == pytest.approx(0.84903 + 1.40524j, abs=1e-4)
    assert odd == pytest.approx(0.53392 + 1.14704j, abs=1e-4)


def test_energy_and_optical_theorem() -> None:
    """Transparent cylinders: Re of the forward amplitude is the power scattered, for each polarisation and ζ."""
    for m in (1.5 / 1.35, 1.5, 0.75):
        for x in (0.3, 3.0, 29.7):
            for zeta in (0.05, 0.6, 1.2, 0.5 * math.pi):
                b1, a1, a2 = ours(m, x, zeta)
                for own in (b1, a2):
                    ext = own[0].real + 2.0 * own[1:].real.sum()
                    sca = abs(own[0]) ** 2 + 2.0 * (np.abs(own[1:]) ** 2 + np.abs(a1[1:]) ** 2).sum()
                    assert ext == pytest.approx(sca, rel=1e-10)


@pytest.mark.parametrize("m", [1.5, 0.8, 1.5 - 0.3j])
@pytest.mark.parametrize("zeta", [0.4, 1.1, 0.5 * math.pi])
def test_thin_cylinder_is_a_line_of_dipoles(m: complex, zeta: float) -> None:
    """x → 0: polarisability m² − 1 along the axis, 2 (m² − 1)/(m² + 1) across.

    Each dipole p shines |s × (s × p)|² in direction s, and a phased line of them on the cone alone.
    """
    x = 1e-3
    square = complex(m) ** 2
    along, across = square - 1.0, 2.0 * (square - 1.0) / (square + 1.0)
    c, s = math.cos(zeta), math.sin(zeta)
    phi = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    out = np.stack([s * np.cos(phi), s * np.sin(phi), np.full_like(phi, c)])
    q = []
    for field in ((-c, 0.0, s), (0.0, 1.0, 0.0)):  # wave along (s, 0, c)
        p = np.array([across * field[0], across * field[1], along * field[2]])
        power = (np.abs(p) ** 2).sum() - np.abs(p @ out) ** 2
        # T = (π x²/4) p_perp: b_0 = −iπ x² (m² − 1)/4 at normal incidence (Bohren & Huffman 1983, p. 207)
        q.append(2.0 / x * (np.pi * x**2 / 4.0) ** 2 * float(power.mean()))
    got = cylinder(m, x, zeta)
    assert float(got.q_sca_tm) == pytest.approx(q[0], rel=3e-5)
    assert float(got.q_sca_te) == pytest.approx(q[1], rel=3e-5)


def test_nearly_matched_large_cylinder_is_anomalous_diffraction() -> None:
    """At normal incidence Q → ∫ (1 − cos(ρ cos γ)) cos γ dγ over −π/2 … π/2, ρ = 2x(m − 1) (van de Hulst 1957)."""
    x, m = 2000.0, 1.001
    gamma = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 20_001)
    rho = 2.0 * x * (m - 1.0)
    exact = float(np.trapezoid((1.0 - np.cos(rho * np.cos(gamma))) * np.cos(gamma), gamma))
    got = cylinder(m, x)
    assert float(got.q_ext_tm) == pytest.approx(exact, rel=3e-3)
    assert float(got.q_ext_te) == pytest.approx(exact, rel=3e-3)


def test_mean_over_orientations_by_a_plain_rule() -> None:
    zeta = (np.arange(20_000) + 0.5) / 20_000 * 0.5 * np.pi
    weight = np.sin(zeta) / np.sin(zeta).sum()
    for m, x in ((1.5 / 1.35, 0.5), (1.5 / 1.35, 29.7), (0.75, 10.0), (1.5 - 0.05j, 10.0)):
        one, mean = cylinder(m, x, zeta), cylinder_mean(m, x)
        for row, value in zip(one[:4], mean[:4], strict=True):
            assert float(value) == pytest.approx(float(weight @ row), rel=3e-5)
        turn = weight @ (one.q_sca * one.anisotropy) / (weight @ one.q_sca)
        assert float(mean.anisotropy) == pytest.approx(float(turn), abs=2e-5)
