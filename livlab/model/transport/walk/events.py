"""What happens to a photon at a collision and at an interface, on Dr.Jit arrays.

Scattering angles are carried as w = 1 − cos θ, which a single-precision float resolves in a forward peak
where cos θ itself cannot.
"""

from __future__ import annotations

from typing import Any

from livlab.model.transport.device import Device
from livlab.model.transport.walk.tables import HENYEY_GREENSTEIN, ISOTROPIC, RAYLEIGH, Tables

# Least-squares fits on |x| ≤ 1/2, errors 7e-9 and 5e-8: half a turn needs no reduction of the argument.
_SIN = (3.1415926401575964, -5.16771008458668, 2.550077533631803, -0.5982913138864446, 0.07765766203643525)
_COS = (0.9999999533410351, -4.934792834369884, 4.058411389117124, -1.3318766667770732, 0.21968961827100647)


def _horner(d: Device, coefficients: tuple[float, ...], x: Any) -> Any:
    value = d.Float(coefficients[-1])
    for c in reversed(coefficients[:-1]):
        value = d.dr.fma(value, x, c)
    return value


def cosine_of_turn(d: Device, u: Any) -> Any:
    """The cosine of an azimuth uniform over the circle, from u in [0, 1): cos πu up to its sign."""
    x = u - 0.5
    return x * _horner(d, _SIN, x * x)


def turn(d: Device, u: Any) -> tuple[Any, Any]:
    """(cos 2πu, sin 2πu) up to a common sign, by doubling the half angle."""
    x = u - 0.5
    s = x * _horner(d, _SIN, x * x)
    c = _horner(d, _COS, x * x)
    return 1.0 - 2.0 * s * s, 2.0 * s * c


def henyey_greenstein(d: Device, g: Any, u: Any) -> Any:
    """1 − cos θ = 2 (1 − g)² v (1 + g u) / (1 − g + 2 g u)², v = 1 − u; exact for g = 0, no cancellation near 1."""
    r = (1.0 - g) * d.dr.rcp(1.0 - g + 2.0 * g * u)
    return d.dr.minimum(2.0 * r * r * (1.0 - u) * (1.0 + g * u), 2.0)


def rayleigh(d: Device, u: Any) -> Any:
    """1 − cos θ by Cardano: µ³ + 3µ = 8u − 4."""
    k = 4.0 * u - 2.0
    root = d.dr.cbrt(d.dr.abs(k) + d.dr.sqrt(k * k + 1.0))
    return d.dr.clip(1.0 - d.dr.mulsign(root - d.dr.rcp(root), k), 0.0, 2.0)


def tabulated(d: Device, t: Tables, table: Any, offset: Any, u: Any) -> Any:
    """1 − cos θ by one look-up; `livlab.model.tissue.phase.functions.KernelTable` describes the layout."""
    dr = d.dr
    forward = u >= 0.5
    p = dr.select(forward, 1.0 - u, u)
    bits = dr.reinterpret_array(d.UInt32, p)
    first = 2.0 ** -(t.table_octaves + 1)
    tail = p < first
    cell = dr.select(tail, 0, (bits >> t.table_shift) - (t.table_base - 1))
    low = d.Float(bits & ((1 << t.table_shift) - 1)) * 2.0**-t.table_shift
    f = dr.select(tail, p * (1.0 / first), low)
    at = offset + dr.select(forward, t.table_row, 0) + cell
    left, right = dr.gather(d.Float, table, at), dr.gather(d.Float, table, at + 1)
    return dr.fma(right - left, f, left)


def polar(d: Device, t: Tables, table: Any, kind: Any, g: Any, offset: Any, u: Any) -> Any:
    """1 − cos θ of a scattering, code made only for the kinds of phase function in use."""
    make = {
        ISOTROPIC: lambda: 2.0 * (1.0 - u),
        RAYLEIGH: lambda: rayleigh(d, u),
        HENYEY_GREENSTEIN: lambda: henyey_greenstein(d, g, u),
    }
    value = None
    for k in t.shape.kinds:
        w = make[k]() if k in make else tabulated(d, t, table, offset, u)
        value = w if value is None else d.dr.select(kind == k, w, value)
    return value


def rotate(d: Device, u: tuple[Any, Any, Any], w: Any, cos_phi: Any, sin_phi: Any) -> tuple[Any, Any, Any]:
    """Turn a unit vector by θ (w = 1 − cos θ) and azimuth φ, in the frame of Duff et al. 2017 (JCGT 6:1).

    One Newton step keeps the length at 1 over thousands of turns.
    """
    dr = d.dr
    ux, uy, uz = u
    sine = dr.sqrt(dr.maximum(w * (2.0 - w), 0.0))
    cosine = 1.0 - w
    a_, b_ = sine * cos_phi, sine * sin_phi
    sign = dr.mulsign(d.Float(1.0), uz)
    a = -dr.rcp(sign + uz)
    b = ux * uy * a
    x = a_ * (1.0 + sign * ux * ux * a) + b_ * b + cosine * ux
    y = a_ * sign * b + b_ * (sign + uy * uy * a) + cosine * uy
    z = -a_ * sign * ux - b_ * uy + cosine * uz
    scale = 1.5 - 0.5 * (x * x + y * y + z * z)
    return x * scale, y * scale, z * scale


def tilt(d: Device, mu: Any, w: Any, cos_phi: Any) -> Any:
    """The cosine with the normal after a turn: µ cos θ + √(1 − µ²) sin θ cos φ."""
    dr = d.dr
    across = dr.sqrt(dr.maximum((1.0 - mu) * (1.0 + mu) * w * (2.0 - w), 0.0))
    return dr.clip(dr.fma(across, cos_phi, mu * (1.0 - w)), -1.0, 1.0)


def fresnel(d: Device, eta: Any, contrast: Any, cos_in: Any) -> tuple[Any, Any]:
    """Reflectance of unpolarised light and cosine behind, 1 and 0 beyond the critical angle.

    η = n₁/n₂ and the contrast 1 − η² come from double precision, so that c₂² = 1 − η² + η² c₁² keeps the
    difference of nearly equal indices; r_s = (η c₁ − c₂)/(η c₁ + c₂), r_p = (c₁ − η c₂)/(c₁ + η c₂).
    """
    dr = d.dr
    before = eta * cos_in
    squared = dr.fma(before, before, contrast)
    behind = dr.sqrt(dr.maximum(squared, 0.0))
    after = eta * behind
    s, p = before + behind, cos_in + after
    both = dr.rcp(dr.maximum(s * p, 1e-20))  # one division serves two
    r_s = (before - behind) * p * both
    r_p = (cos_in - after) * s * both
    return dr.select(squared <= 0.0, 1.0, 0.5 * dr.fma(r_s, r_s, r_p * r_p)), behind
