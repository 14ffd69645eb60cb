"""Spheres and cylinders by their series in many digits, written out from the boundary conditions."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .precise import mpmath, spread


def sphere(m: list[float], x: list[float]) -> dict[str, list[Any]]:
    """q_ext, q_sca and anisotropy of a sphere: Bohren & Huffman 1983, eqs. 4.61, 4.62, 4.88 and p. 120.

    The logarithmic derivative runs downwards; ψ and ξ run upwards with digits to spare for what that loses.
    """
    rows = [_sphere(m, size) for size in x]
    return {name: [row[k] for row in rows] for k, name in enumerate(("q_ext", "q_sca", "anisotropy"))}


def _sphere(m: list[float], x: float) -> tuple[Any, Any, Any]:
    mp = mpmath()
    top = int(x + 6.0 * x ** (1 / 3) + 12)
    with mp.workdps(50 + int(2 * top * max(0.0, -math.log10(x)))):
        index, size = mp.mpc(m[0], m[1]), mp.mpf(x)
        inside = index * size
        start = _start(top, abs(inside))
        derivative = mp.mpc(0)
        kept = [mp.mpc(0)] * (top + 1)
        for n in range(start, 0, -1):
            derivative = n / inside - 1 / (derivative + n / inside)
            if n - 1 <= top:
                kept[n - 1] = derivative
        psi_before, psi = mp.cos(size), mp.sin(size)
        chi_before, chi = -mp.sin(size), mp.cos(size)
        total, extinction, turn = mp.mpf(0), mp.mpf(0), mp.mpf(0)
        a_before, b_before = mp.mpc(0), mp.mpc(0)
        for n in range(1, top + 1):
            psi_before, psi = psi, (2 * n - 1) / size * psi - psi_before
            chi_before, chi = chi, (2 * n - 1) / size * chi - chi_before
            xi, xi_before = mp.mpc(psi, -chi), mp.mpc(psi_before, -chi_before)
            electric, magnetic = kept[n] / index + n / size, kept[n] * index + n / size
            a = (electric * psi - psi_before) / (electric * xi - xi_before)
            b = (magnetic * psi - psi_before) / (magnetic * xi - xi_before)
            power = (2 * n + 1) * (_square(a) + _square(b))
            total += power
            extinction += (2 * n + 1) * (a.real + b.real)
            turn += mp.mpf(2 * n + 1) / (n * (n + 1)) * _product(a, b)
            if n > 1:
                turn += mp.mpf((n - 1) * (n + 1)) / n * (_product(a_before, a) + _product(b_before, b))
            a_before, b_before = a, b
            if n > 3 and power < total * mp.mpf(10) ** -40:
                break
        q_sca = 2 * total / size**2
        q_ext = q_sca if m[1] == 0.0 else 2 * extinction / size**2
        return +q_ext, +q_sca, +(2 * turn / total)


def cylinder(m: list[float], x: Any, zeta: Any) -> dict[str, list[Any]]:
    """Efficiencies and anisotropy of infinite cylinders at oblique incidence, unpolarised.

    E_z and H_z inside and outside are series of Bessel functions in e^{inφ}; the fields' continuity gives two
    equations a term (no closed form is used: Bohren & Huffman 1983, eq. 8.30, serve livlab itself).
    """
    rows = [_cylinder(m, size, angle) for size, angle in spread(x, zeta)]
    return {name: [row[k] for row in rows] for k, name in enumerate(("q_ext", "q_sca", "anisotropy"))}


def cylinder_mean(m: list[float], x: list[float], nodes: int = 24) -> dict[str, list[Any]]:
    """The mean over all directions of the axis by Gauss's rule in ζ: for cylinders too thin for resonances."""
    mp = mpmath()
    out: dict[str, list[Any]] = {"q_ext": [], "q_sca": [], "anisotropy": []}
    points = list(zip(*np.polynomial.legendre.leggauss(nodes), strict=True))
    for size in x:
        q_ext, q_sca, turn = mp.mpf(0), mp.mpf(0), mp.mpf(0)
        for p, w in points:
            angle = mp.pi / 4 * (float(p) + 1)
            e, s, g = _cylinder(m, size, angle)
            weight = mp.pi / 4 * float(w) * mp.sin(angle)
            q_ext, q_sca, turn = q_ext + weight * e, q_sca + weight * s, turn + weight * s * g
        for name, value in (("q_ext", q_ext), ("q_sca", q_sca), ("anisotropy", turn / q_sca)):
            out[name].append(value)
    return out


def _cylinder(m: list[float], x: float, zeta: Any) -> tuple[Any, Any, Any]:
    mp = mpmath()
    across = float(x) * math.sin(float(zeta))
    top = int(across + 6.0 * across ** (1 / 3) + 14)
    with mp.workdps(60 + int(4 * top * max(0.0, -math.log10(across)))):
        index, size = mp.mpc(m[0], m[1]), mp.mpf(x)
        along, sine = mp.cos(zeta), mp.sin(zeta)
        inner = mp.sqrt(index * index - along * along)
        J = _bessel_j(mp, sine * size, top + 1)
        Y = [mp.bessely(0, sine * size), mp.bessely(1, sine * size)]
        for n in range(1, top + 1):
            Y.append(2 * n / (sine * size) * Y[n] - Y[n - 1])
        rod = _Rod(index, size, along, sine, inner, J, Y, _log_derivatives(mp, inner * size, top))
        power, extinction, turn = mp.mpf(0), mp.mpf(0), mp.mpf(0)
        before: list[tuple[Any, Any]] = []
        for n in range(top + 1):
            now = _cylinder_term(mp, n, rod)
            twice = 1 if n == 0 else 2
            part = twice * sum(_square(p) + _square(q) for p, q in now)
            power += part
            extinction += twice * (now[0][0].real + now[1][0].real)
            if before:
                # Σ over all n of Re(c_n c*_{n+1}); negative orders give the same, or the same with both signs turned.
                turn += 2 * sum(_product(p, r) + _product(q, s) for (p, q), (r, s) in zip(before, now, strict=True))
            before = now
            if n > 3 and part < power * mp.mpf(10) ** -40:
                break
        q_sca = power / size  # the mean of two polarisations, 2/x each
        q_ext = q_sca if m[1] == 0.0 else extinction / size
        g = along**2 + sine**2 * turn / power
        return +q_ext, +q_sca, +g


class _Rod(NamedTuple):
    """A cylinder under light: its index and size, cosine and sine of ζ, the inner wave number, functions by order."""

    index: Any
    size: Any
    along: Any
    sine: Any
    inner: Any
    J: Any
    Y: Any
    D: Any


def _cylinder_term(mp: Any, n: int, rod: _Rod) -> list[tuple[Any, Any]]:
    """(co-polar, cross-polar) coefficients of order n for E, then H along the axis, unit incident field each."""
    index, size, along, sine, inner, J, Y, _ = rod
    D = rod.D[n]
    j, h = J[n], mp.mpc(J[n], Y[n])
    z = sine * size
    dj = (J[n - 1] if n else -J[1]) - n / z * j
    dh = (mp.mpc(J[n - 1], Y[n - 1]) if n else -mp.mpc(J[1], Y[1])) - n / z * h
    q = mp.mpc(0, 1) * along * n / size * (1 / sine**2 - 1 / inner**2)
    # E_φ and H_φ continuous: q(eJ + aH) − (gJ' + bH')/κ + D(gJ + bH)/κ₁ = 0, and its dual with m².
    magnetic, electric = D / inner, index * index * D / inner
    A, B = q * h, magnetic * h - dh / sine
    C, E = dh / sine - electric * h, q * h
    found = []
    for e, g in ((1, 0), (0, 1)):
        p = -e * q * j - g * (magnetic * j - dj / sine)
        s = -e * (dj / sine - electric * j) - g * q * j
        determinant = A * E - B * C
        a, b = (p * E - B * s) / determinant, (A * s - p * C) / determinant
        found.append((-a, -b) if e else (-b, -a))
    return found


def _bessel_j(mp: Any, z: Any, top: int) -> list[Any]:
    """J_0 … J_top by downward recurrence, with J_0 + 2 Σ J_2k = 1."""
    start = _start(top, z)
    after, now = mp.mpf(0), mp.mpf(1)
    found = [mp.mpf(0)] * (top + 1)
    total = mp.mpf(0)
    for n in range(start, -1, -1):
        if n <= top:
            found[n] = now
        if n % 2 == 0:
            total += now if n == 0 else 2 * now
        after, now = now, 2 * n / z * now - after
    return [x / total for x in found]


def _log_derivatives(mp: Any, z: Any, top: int) -> list[Any]:
    """J_n'/J_n for n = 0 … top."""
    ratio = mp.mpc(0)
    found = [mp.mpc(0)] * (top + 1)
    for n in range(_start(top, abs(z)), -1, -1):
        # ratio = J_{n+1}/J_n
        ratio = 1 / (2 * (n + 1) / z - ratio)
        if n <= top:
            found[n] = n / z - ratio
    return found


def _start(top: int, z: Any) -> int:
    """Order from which a downward recurrence has forgotten its start: the region n < |z| forgets nothing."""
    return max(top, int(float(z) + 20 * float(z) ** (1 / 3))) + 80


def _square(a: Any) -> Any:
    return a.real**2 + a.imag**2


def _product(a: Any, b: Any) -> Any:
    return a.real * b.real + a.imag * b.imag
