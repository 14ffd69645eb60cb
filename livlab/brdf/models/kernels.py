"""Compiled lobes of isotropic BRDFs as functions of three cosines: n·wi, n·wo and wi·wo.

An isotropic BRDF that does not change when the surface is mirrored depends on nothing else. Import this module only
where a kernel is needed: numba takes a third of a second to load.
"""

from __future__ import annotations

import math

from livlab.brdf.models.codes import CONDUCTOR, DIELECTRIC, GGX, SCHLICK, Facets
from livlab.core.compiled import compiled
from livlab.units import FloatArray


@compiled
def dielectric(cos: float, eta: float) -> float:
    """Reflectance of unpolarised light from outside, cosine within the denser or thinner medium of relative index eta.

    Born & Wolf 1999, section 1.5.3; 1 beyond the critical angle.
    """
    inner = eta * eta - 1.0 + cos * cos
    if inner <= 0.0:
        return 1.0
    g = math.sqrt(inner)
    s = (cos - g) / (cos + g)
    p = (g - eta * eta * cos) / (g + eta * eta * cos)
    return 0.5 * (s * s + p * p)


@compiled
def conductor(cos: float, eta: float, k: float) -> float:
    """Reflectance of unpolarised light by a conductor of index eta + ik in air (Born & Wolf 1999, section 14.4.1)."""
    cos2 = cos * cos
    sin2 = 1.0 - cos2
    t0 = eta * eta - k * k - sin2
    a2b2 = math.sqrt(max(t0 * t0 + 4.0 * eta * eta * k * k, 0.0))
    a = math.sqrt(max(0.5 * (a2b2 + t0), 0.0))
    t1, t2 = a2b2 + cos2, 2.0 * cos * a
    s = (t1 - t2) / (t1 + t2)
    t3, t4 = a2b2 * cos2 + sin2 * sin2, t2 * sin2
    p = s * (t3 - t4) / (t3 + t4) if t3 + t4 > 0.0 else s
    return 0.5 * (s + p)


@compiled
def smith_lambda(cos: float, alpha: float, distribution: int) -> float:
    """Smith's Λ of a direction; for Beckmann the rational approximation of Walter et al. 2007 (eq. 27)."""
    tan2 = max(1.0 - cos * cos, 0.0) / (cos * cos)
    if distribution == GGX:
        return 0.5 * (math.sqrt(1.0 + alpha * alpha * tan2) - 1.0)
    if tan2 == 0.0:
        return 0.0
    a = 1.0 / (alpha * math.sqrt(tan2))
    if a >= 1.6:
        return 0.0
    return (1.0 + 2.276 * a + 2.577 * a * a) / (3.535 * a + 2.181 * a * a) - 1.0


@compiled
def microfacet(
    cos_i: FloatArray,
    cos_o: FloatArray,
    cos_io: FloatArray,
    alpha: float,
    facets: Facets,
    f1: float,
    f2: float,
    out: FloatArray,
) -> None:
    """F D G / (4 cos θ_i cos θ_o) (Walter et al. 2007, eq. 20) with Smith's G, separable or height-correlated."""
    distribution, fresnel, correlated = facets
    a2 = alpha * alpha
    for j in range(out.size):
        ci, co, total = cos_i[j], cos_o[j], 2.0 + 2.0 * cos_io[j]
        if ci <= 0.0 or co <= 0.0 or total <= 0.0:
            out[j] = 0.0
            continue
        root = math.sqrt(total)
        ch = (ci + co) / root
        cd = 0.5 * root
        ch2 = ch * ch
        sin2 = max(1.0 - ch2, 0.0)
        if distribution == GGX:
            inner = sin2 + a2 * ch2
            d = a2 / (math.pi * inner * inner)
        else:
            d = math.exp(-sin2 / (ch2 * a2)) / (math.pi * a2 * ch2 * ch2)
        li, lo = smith_lambda(ci, alpha, distribution), smith_lambda(co, alpha, distribution)
        g = 1.0 / (1.0 + li + lo) if correlated else 1.0 / ((1.0 + li) * (1.0 + lo))
        if fresnel == DIELECTRIC:
            f = dielectric(cd, f1)
        elif fresnel == CONDUCTOR:
            f = conductor(cd, f1, f2)
        elif fresnel == SCHLICK:
            x = 1.0 - cd
            f = f1 + (1.0 - f1) * x * x * x * x * x
        else:
            f = 1.0
        out[j] = f * d * g / (4.0 * ci * co)


@compiled
def blinn_phong(
    cos_i: FloatArray, cos_o: FloatArray, cos_io: FloatArray, exponent: float, classic: bool, out: FloatArray
) -> None:
    """(n·h)^m, normalised to a normal-incidence albedo of 1, or (`classic`) divided by the light's cosine."""
    m = exponent
    scale = (m + 2.0) * (m + 4.0) / (8.0 * math.pi * (math.exp2(-0.5 * m) + m))
    for j in range(out.size):
        ci, co, total = cos_i[j], cos_o[j], 2.0 + 2.0 * cos_io[j]
        if ci <= 0.0 or co <= 0.0 or total <= 0.0:
            out[j] = 0.0
            continue
        ch = min((ci + co) / math.sqrt(total), 1.0)
        lobe = ch**m
        out[j] = lobe / ci if classic else scale * lobe


@compiled
def ashikhmin_shirley(
    cos_i: FloatArray, cos_o: FloatArray, cos_io: FloatArray, exponent: float, rs: float, out: FloatArray
) -> None:
    """Isotropic lobe with Schlick's Fresnel (Ashikhmin & Shirley 2000, eq. 4 with n_u = n_v)."""
    m = exponent
    for j in range(out.size):
        ci, co, total = cos_i[j], cos_o[j], 2.0 + 2.0 * cos_io[j]
        if ci <= 0.0 or co <= 0.0 or total <= 0.0:
            out[j] = 0.0
            continue
        root = math.sqrt(total)
        ch = min((ci + co) / root, 1.0)
        cd = 0.5 * root
        x = 1.0 - cd
        f = rs + (1.0 - rs) * x * x * x * x * x
        out[j] = (m + 1.0) / (8.0 * math.pi) * ch**m * f / (cd * max(ci, co))


@compiled
def ashikhmin_shirley_diffuse(cos_i: FloatArray, cos_o: FloatArray, rs: float, out: FloatArray) -> None:
    """28/(23π) (1 − R_s) (1 − (1 − cos θ_i/2)⁵) (1 − (1 − cos θ_o/2)⁵) (Ashikhmin & Shirley 2000, eq. 5)."""
    scale = 28.0 / (23.0 * math.pi) * (1.0 - rs)
    for j in range(out.size):
        ci, co = cos_i[j], cos_o[j]
        if ci <= 0.0 or co <= 0.0:
            out[j] = 0.0
            continue
        x, y = 1.0 - 0.5 * ci, 1.0 - 0.5 * co
        out[j] = scale * (1.0 - x * x * x * x * x) * (1.0 - y * y * y * y * y)


@compiled
def oren_nayar(
    cos_i: FloatArray,
    cos_o: FloatArray,
    cos_io: FloatArray,
    sigma: float,
    full: bool,
    out: FloatArray,
    twice: FloatArray,
) -> None:
    """Oren & Nayar 1994: `out` per albedo (eq. 25, 27, or the qualitative 30), `twice` per squared albedo (eq. 26)."""
    s2 = sigma * sigma
    a_term = 1.0 - 0.5 * s2 / (s2 + 0.33)
    b_term = 0.45 * s2 / (s2 + 0.09)
    for j in range(out.size):
        ci, co = min(cos_i[j], 1.0), min(cos_o[j], 1.0)
        twice[j] = 0.0
        if ci <= 0.0 or co <= 0.0:
            out[j] = 0.0
            continue
        across = math.sqrt(max(1.0 - ci * ci, 0.0)) * math.sqrt(max(1.0 - co * co, 0.0))
        # Along the normal the azimuth has no meaning; every term with it then vanishes or is even in it.
        cos_phi = min(max((cos_io[j] - ci * co) / across, -1.0), 1.0) if across > 1e-12 else 1.0
        high, low = math.acos(min(ci, co)), math.acos(max(ci, co))
        if not full:
            out[j] = (a_term + b_term * max(cos_phi, 0.0) * math.sin(high) * math.tan(low)) / math.pi
            continue
        share = 2.0 * low / math.pi
        c2 = b_term * (math.sin(high) if cos_phi >= 0.0 else math.sin(high) - share * share * share)
        c3 = 0.125 * s2 / (s2 + 0.09) * (4.0 * high * low / (math.pi * math.pi)) ** 2
        single = a_term + cos_phi * c2 * math.tan(low) + (1.0 - abs(cos_phi)) * c3 * math.tan(0.5 * (high + low))
        out[j] = single / math.pi
        twice[j] = 0.17 / math.pi * s2 / (s2 + 0.13) * (1.0 - cos_phi * share * share)


@compiled
def lafortune(
    cos_i: FloatArray, cos_o: FloatArray, cos_io: FloatArray, ratio: float, exponent: float, out: FloatArray
) -> None:
    """One isotropic cosine lobe (Lafortune et al. 1997, eq. 8), C_xy = −C_z/ratio, scaled to 1 at the mirror of 45°."""
    scale = (exponent + 2.0) / (2.0 * math.pi)
    norm = 2.0 / (1.0 + ratio)
    for j in range(out.size):
        ci, co = cos_i[j], cos_o[j]
        dot = norm * (ratio * ci * co - (cos_io[j] - ci * co))
        out[j] = scale * dot**exponent if ci > 0.0 and co > 0.0 and dot > 0.0 else 0.0


@compiled
def burley(cos_i: FloatArray, cos_o: FloatArray, cos_io: FloatArray, alpha: float, out: FloatArray) -> None:
    """Burley's diffuse lobe with retroreflection (Burley 2015, section 3), roughness² = alpha."""
    for j in range(out.size):
        ci, co = cos_i[j], cos_o[j]
        if ci <= 0.0 or co <= 0.0:
            out[j] = 0.0
            continue
        x, y = (1.0 - ci) ** 5, (1.0 - co) ** 5
        retro = math.sqrt(alpha) * (1.0 + cos_io[j])
        out[j] = ((1.0 - 0.5 * x) * (1.0 - 0.5 * y) + retro * (x + y + x * y * (retro - 1.0))) / math.pi


@compiled
def table_product(cos_i: FloatArray, cos_o: FloatArray, table: FloatArray, scale: float, out: FloatArray) -> None:
    """Scale × T(cos θ_i) T(cos θ_o), T by linear interpolation between equal steps of the cosine."""
    last = table.size - 1
    for j in range(out.size):
        ci, co = cos_i[j], cos_o[j]
        if ci <= 0.0 or co <= 0.0:
            out[j] = 0.0
            continue
        product = scale
        for c in (ci, co):
            x = min(c, 1.0) * last
            k = min(int(x), last - 1)
            product *= table[k] + (x - k) * (table[k + 1] - table[k])
        out[j] = product
