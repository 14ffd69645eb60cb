"""Mie against printed values and against the thesis's equations written out, slowly, term by term."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import spherical_jn, spherical_yn

from livlab.model.tissue.particles.sphere import mie, mie_intensity, mie_phase, vacuum_efficiency


def literal_coefficients(m: complex, x: float, terms: int) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Nunes 2019, eqs. 3.5, 3.6 with ψ = z j_n (reading row 1), ξ = z h_n, y = m x; exp(−iωt), m = n + ik."""
    n = np.arange(1, terms + 1)
    y = m * x

    def psi(z: complex) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        j, dj = spherical_jn(n, z), spherical_jn(n, z, derivative=True)
        return z * j, j + z * dj

    psi_x, dpsi_x = psi(x)
    psi_y, dpsi_y = psi(y)
    h = spherical_jn(n, x) + 1j * spherical_yn(n, x)
    dh = spherical_jn(n, x, derivative=True) + 1j * spherical_yn(n, x, derivative=True)
    xi, dxi = x * h, h + x * dh
    a = (m * psi_y * dpsi_x - psi_x * dpsi_y) / (m * psi_y * dxi - xi * dpsi_y)
    b = (psi_y * dpsi_x - m * psi_x * dpsi_y) / (psi_y * dxi - m * xi * dpsi_y)
    return a, b


def literal_amplitudes(
    a: NDArray[np.complex128], b: NDArray[np.complex128], mu: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Nunes 2019, eqs. 3.3, 3.4, 3.9, 3.10: S1, S2 from π_n and τ_n by their recurrences."""
    before, pi = np.zeros_like(mu), np.ones_like(mu)
    s1 = np.zeros(mu.shape, dtype=complex)
    s2 = np.zeros(mu.shape, dtype=complex)
    for k in range(a.size):
        n = k + 1
        tau = n * mu * pi - (n + 1) * before
        factor = (2 * n + 1) / (n * (n + 1))
        s1 += factor * (a[k] * pi + b[k] * tau)
        s2 += factor * (a[k] * tau + b[k] * pi)
        before, pi = pi, ((2 * n + 1) * mu * pi - (n + 1) * before) / n
    return s1, s2


@pytest.mark.parametrize("m", [1.5 / 1.35, 1.5, 0.75, 1.33 - 0.01j, 1.5 - 1j, 3.0 - 0.2j, 0.03])
@pytest.mark.parametrize("x", [0.11, 0.7, 3.0, 11.3, 29.7])
def test_thesis_equations(m: complex, x: float) -> None:
    a, b = literal_coefficients(complex(m).conjugate(), x, int(x + 8.0 * x ** (1 / 3) + 6))
    mu, weight = np.polynomial.legendre.leggauss(4 * a.size + 8)
    s1, s2 = literal_amplitudes(a, b, mu)
    power = np.abs(s1) ** 2 + np.abs(s2) ** 2
    q_sca = float(weight @ power) / x**2  # eq. 6.5 with k in the medium, sin θ dθ = dµ
    forward = literal_amplitudes(a, b, np.ones(1))[0][0]
    back = literal_amplitudes(a, b, -np.ones(1))[0][0]
    got = mie(m, x)
    assert float(got.q_sca) == pytest.approx(q_sca, rel=2e-7)
    assert float(got.q_ext) == pytest.approx(4.0 / x**2 * forward.real, rel=2e-7)  # optical theorem
    assert float(got.anisotropy) == pytest.approx(float(weight @ (power * mu)) / float(weight @ power), abs=3e-7)
    assert float(got.q_back) == pytest.approx(4.0 / x**2 * abs(back) ** 2, rel=1e-4)
    cosines = np.linspace(-1.0, 1.0, 41)
    s1, s2 = literal_amplitudes(a, b, cosines)
    exact = 0.5 * (np.abs(s1) ** 2 + np.abs(s2) ** 2)
    assert mie_intensity(m, x, cosines) == pytest.approx(exact, rel=1e-5, abs=1e-7 * exact.max())


def exact_efficiencies(m: complex, x: float, terms: int = 6) -> tuple[float, float, float]:
    """Q_ext, Q_sca, g in 80 digits, Riccati–Bessel functions as half-integer Bessel functions."""
    with mp.workdps(80):
        inside, size = mp.mpc(m), mp.mpf(x)

        def psi(n: int, z: mp.mpc) -> mp.mpc:
            return mp.sqrt(mp.pi * z / 2) * mp.besselj(n + mp.mpf(1) / 2, z)

        def xi(n: int, z: mp.mpc) -> mp.mpc:
            return mp.sqrt(mp.pi * z / 2) * mp.hankel1(n + mp.mpf(1) / 2, z)

        y = inside * size
        a, b = [], []
        for n in range(1, terms + 1):
            px, py, hx = psi(n, size), psi(n, y), xi(n, size)
            dpx = psi(n - 1, size) - n / size * px
            dpy = psi(n - 1, y) - n / y * py
            dhx = xi(n - 1, size) - n / size * hx
            a.append((inside * py * dpx - px * dpy) / (inside * py * dhx - hx * dpy))
            b.append((py * dpx - inside * px * dpy) / (py * dhx - inside * hx * dpy))
        ext = sum((2 * n + 1) * (a[n - 1] + b[n - 1]).real for n in range(1, terms + 1))
        sca = sum((2 * n + 1) * (abs(a[n - 1]) ** 2 + abs(b[n - 1]) ** 2) for n in range(1, terms + 1))
        turn = sum(
            mp.mpf(n * (n + 2)) / (n + 1) * (a[n - 1] * mp.conj(a[n]) + b[n - 1] * mp.conj(b[n])).real
            for n in range(1, terms)
        )
        turn += sum(
            mp.mpf(2 * n + 1) / (n * (n + 1)) * (a[n - 1] * mp.conj(b[n - 1])).real for n in range(1, terms + 1)
        )
        return float(2 * ext / size**2), float(2 * sca / size**2), float(2 * turn / sca)


SMALL = [1.5, 1.5 / 1.35, 0.75, 1.5 - 0.1j, 1.5 - 1e-9j, 0.1 - 3j, 1.0 + 1e-9, 1.0 - 1e-6j, 8.0 - 0.5j]


@pytest.mark.parametrize("m", SMALL)
@pytest.mark.parametrize("x", [1e-8, 1e-6, 1e-3, 0.02, 0.0999])
def test_small_spheres_in_80_digits(m: complex, x: float) -> None:
    q_ext, q_sca, g = exact_efficiencies(complex(m).conjugate(), x)
    got = mie(m, x)
    assert float(got.q_sca) == pytest.approx(q_sca, rel=1e-12)
    # Where k is 1e-9 of n, rounding of n itself leaves its mark on the small absorption.
    assert float(got.q_ext) == pytest.approx(q_ext, rel=1e-12 if abs(complex(m).imag) > 1e-7 or m == 1.5 else 1e-6)
    assert float(got.anisotropy) == pytest.approx(g, rel=1e-11)


@pytest.mark.parametrize("m", [1.0 + 1e-9, 1.0 - 3e-5, 1.0 + 9e-4, 1.0 - 1e-6j, 1.0005 - 2e-4j])
@pytest.mark.parametrize("x", [0.3, 2.0, 12.0])
def test_nearly_matched_spheres_in_80_digits(m: complex, x: float) -> None:
    q_ext, q_sca, g = exact_efficiencies(complex(m).conjugate(), x, terms=int(x + 6 * x ** (1 / 3) + 6))
    got = mie(m, x)
    assert float(got.q_sca) == pytest.approx(q_sca, rel=2e-7)  # truncation after Wiscombe's number of terms
    assert float(got.q_ext) == pytest.approx(q_ext, rel=2e-7)
    assert float(got.anisotropy) == pytest.approx(g, rel=2e-7)


# m, x, Q_ext, Q_sca, g as printed (Wiscombe 1979; Du 2004), None where not printed; digits as printed.
PRINTED = [
    (0.75, 0.099, "7.417859e-06", "7.417859e-06", "0.001448"),
    (0.75, 10.0, "2.232265", "2.232265", "0.896473"),
    (0.75, 1000.0, "1.997908", "1.997908", "0.844944"),
    (1.5 - 1j, 1.0, "2.336321", "0.6634538", "0.192136"),
    (1.5 - 1j, 100.0, "2.097502", "1.283697", "0.850252"),
    (1.5, 1000.0, "2.0139", None, None),
    # Bohren & Huffman 1983, appendix A: radius 0.525 µm, 632.8 nm, which is x = 5.21282.
    (1.55, 2.0 * math.pi * 0.525 / 0.6328, "3.10543", "3.10543", "0.63314"),
]


@pytest.mark.parametrize(("m", "x", "q_ext", "q_sca", "g"), PRINTED)
def test_printed_values(m: complex, x: float, q_ext: str, q_sca: str | None, g: str | None) -> None:
    got = mie(m, x)
    for value, printed in ((got.q_ext, q_ext), (got.q_sca, q_sca), (got.anisotropy, g)):
        if printed is None:
            continue
        mantissa, _, power = printed.partition("e")
        unit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
        assert abs(float(value) - float(printed)) <= 0.51 * unit


def test_vacuum_wavenumber() -> None:
    # Eq. 6.5 divides by k²r²: k of the vacuum is smaller by n_medium.
    x, n_medium = 3.0, 1.35
    a, b = literal_coefficients(1.5 / n_medium, x, 20)
    mu, weight = np.polynomial.legendre.leggauss(100)
    s1, s2 = literal_amplitudes(a, b, mu)
    printed = float(weight @ (np.abs(s1) ** 2 + np.abs(s2) ** 2)) / (x / n_medium) ** 2
    assert float(vacuum_efficiency(mie(1.5 / n_medium, x).q_sca, n_medium)) == pytest.approx(printed, rel=1e-6)


@pytest.mark.parametrize(("m", "x"), [(1.5 / 1.35, 0.05), (1.5 / 1.35, 5.0), (1.5, 29.7), (1.5 - 0.1j, 80.0)])
def test_phase_moments(m: complex, x: float) -> None:
    """Legendre moments of the table against Gauss's rule on the literal amplitudes."""
    a, b = literal_coefficients(complex(m).conjugate(), x, int(x + 6.0 * x ** (1 / 3) + 4))
    mu, weight = np.polynomial.legendre.leggauss(4 * a.size + 40)
    s1, s2 = literal_amplitudes(a, b, mu)
    power = weight * (np.abs(s1) ** 2 + np.abs(s2) ** 2)
    order = min(2 * a.size, 60)
    moments = np.polynomial.legendre.legvander(mu, order).T @ power / power.sum()
    assert mie_phase(m, x).legendre(order) == pytest.approx(moments, abs=1e-3 if x > 50 else 3e-4)
