"""Light on the cone of an infinite cylinder, and its phase function averaged over the axes' directions.

With intensity I(φ, ζ) = (|T1|² + |T2|² + 2|T3|²)/2 per azimuth (Bohren & Huffman 1983, eqs. 8.34, 8.41), axes
in all directions alike, and 1 − cos Θ = 2 sin²ζ sin²(φ/2), the share scattered at Θ is, with s = sin(Θ/2),

    p(Θ) ∝ (1/s) ∫₀^{π/2} I(φ, ζ) dt,   cos ζ = cos(Θ/2) sin t,   tan(φ/2) = tan(Θ/2)/cos t,

the integral over ζ having lost its inverse square root by the substitution of t. It grows as 1/s towards
Θ = 0, as every cone holds the forward direction: integrable, and cut off only by a fibre's finite length.
"""

from __future__ import annotations

import math

import numpy as np

from livlab.model.tissue.particles.cylinder_kernels import bessel_pair, coefficient_table, orders
from livlab.model.tissue.particles.sphere_series import ComplexArray
from livlab.model.tissue.phase.tabulated import Tabulated
from livlab.units import FloatArray


def cone_intensity(b1: ComplexArray, a1: ComplexArray, a2: ComplexArray, points: int) -> FloatArray:
    """(|T1|² + |T2|² + |T3|² + |T4|²)/2 for coefficients (K, N + 1) at `points` azimuths from 0 to π: (K, points).

    T1 = b_0I + 2 Σ b_nI cos nφ, T2 = a_0II + 2 Σ a_nII cos nφ, T3 = −T4 = −2i Σ a_nI sin nφ (eq. 8.34 and after):
    cosine and sine transforms of type I. N < points − 1.
    """
    from scipy.fft import dct, dst

    def padded(part: ComplexArray, count: int) -> ComplexArray:
        out = np.zeros((part.shape[0], count), dtype=np.complex128)
        out[:, : part.shape[1]] = part
        return out

    out = np.zeros((b1.shape[0], points))
    for part in (b1, a2):
        wave = dct(padded(part, points), type=1)
        out += 0.5 * (wave.real**2 + wave.imag**2)
    wave = dst(padded(a1[:, 1:], points - 2), type=1)
    out[:, 1:-1] += wave.real**2 + wave.imag**2
    return out


def orientation_table(m: complex, x: float, level: int) -> Tabulated:
    """The averaged phase function; each level doubles the table's scattering angles. `m` is n + ik here."""
    from scipy.ndimage import map_coordinates, spline_filter

    zeta = np.linspace(0.0, 0.5 * math.pi, 1 + math.ceil(8.0 * x + 400.0))
    phi = np.linspace(0.0, math.pi, 1 + 8 * (orders(x) + 4))
    sine, cosine = np.sin(zeta), np.cos(zeta)
    contrast = complex((m - 1.0) * (m + 1.0) or 1e-100)  # the shape has a limit at m = 1
    parts = coefficient_table(contrast, x, sine, cosine, bessel_pair(x * sine))
    top = max(float(np.abs(part).max()) for part in parts)
    b1, a1, a2 = (part / top for part in parts)
    grid = spline_filter(cone_intensity(b1, a1, a2, phi.size), order=3, mode="mirror")

    theta = scattering_angles(x, 2**level)
    half_s, half_c = np.sin(0.5 * theta), np.cos(0.5 * theta)
    node, weight = np.polynomial.legendre.leggauss(16)
    panels = math.ceil(6.0 + 0.25 * x)
    t = (0.25 * math.pi / panels * (2.0 * np.arange(panels)[:, None] + 1.0 + node)).ravel()
    weight = np.tile(weight, panels)
    sin_t, cos_t = np.sin(t), np.cos(t)
    mean = np.empty(theta.size)
    for first in range(0, theta.size, 256):
        s, c = half_s[first : first + 256, None], half_c[first : first + 256, None]
        across = c * cos_t
        at_zeta = np.arctan2(np.hypot(s, across), c * sin_t) / zeta[1]
        at_phi = 2.0 * np.arctan2(s, across) / phi[1]
        values = map_coordinates(grid, np.stack([at_zeta, at_phi]), order=3, mode="mirror", prefilter=False)
        mean[first : first + 256] = np.maximum(values, 0.0) @ weight / s[:, 0]
    w = 2.0 * half_s**2
    w[-1] = 2.0
    # A straight line overrates 1/√w in every cell: values are lowered so that 1/√w keeps its mass in each, the
    # first from 0 included.
    root = np.sqrt(w)
    kept = 2.0 * np.diff(root) / (0.5 * np.diff(w) * (1.0 / root[:-1] + 1.0 / root[1:]))
    lowered = mean * 0.5 * (np.append(kept, kept[-1]) + np.insert(kept, 0, kept[0]))
    first_value = 4.0 * mean[0] - lowered[0]
    return Tabulated.from_complement(np.insert(w, 0, 0.0), np.insert(lowered, 0, first_value))


def scattering_angles(x: float, fine: int) -> FloatArray:
    """Angles above 0 up to π: each a fortieth above the last, then in steps of 1/(16 x), all refined by `fine`."""
    step = 0.0625 / max(x, 4.0)
    near = np.geomspace(1e-4 * step, 40.0 * step, 520 * fine, endpoint=False)
    far = np.linspace(40.0 * step, math.pi, 1 + fine * math.ceil((math.pi - 40.0 * step) / step))
    return np.concatenate([near, far])
