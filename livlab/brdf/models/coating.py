"""What a rough dielectric surface lets through and throws back once: the coupling of a coated diffuse base.

Tabulated over the cosine of incidence as Mitsuba's `roughplastic` does, so that the two models are the same function.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from livlab.brdf.models.codes import GGX
from livlab.brdf.models.kernels import dielectric, smith_lambda
from livlab.core.compiled import compiled
from livlab.units import FloatArray

TABLE_SIZE = 64
"""Steps of the cosine; linear interpolation between them is part of the model, up to 2e-4 of it near grazing."""

QUICK_NODES = 24

ORDER_OUTSIDE, ORDER_INSIDE = 32, 128
"""Nodes a side; total reflection inside has an edge that asks for more."""


@compiled
def visible_normal(cos: float, alpha: float, distribution: int, p: float, q: float) -> tuple[float, float]:
    """Cosines (m·w, m·n) of one normal seen from w, and nothing of its azimuth: both are all that one bounce needs.

    GGX: (p, q) is a point of the unit disc, mapped as by Heitz 2018. Beckmann: (p, q) is a normal's slope of unit
    roughness along and across w, its weight then (m·w)+ / m_z.
    """
    sine = math.sqrt(max(1.0 - cos * cos, 0.0))
    if distribution != GGX:
        x, y = alpha * p, alpha * q
        z = 1.0 / math.sqrt(1.0 + x * x + y * y)
        return (sine * x + cos) * z, z
    length = math.sqrt(alpha * alpha * sine * sine + cos * cos)
    sx, cz = alpha * sine / length, cos / length
    share = 0.5 * (1.0 + cz)
    t2 = (1.0 - share) * math.sqrt(max(1.0 - p * p, 0.0)) + share * q
    t3 = math.sqrt(max(1.0 - p * p - t2 * t2, 0.0))
    # Hemisphere around the stretched direction, turned back and unstretched.
    along, across, up = -cz * t2 + sx * t3, p, sx * t2 + cz * t3
    mx, my, mz = alpha * along, alpha * across, max(up, 0.0)
    norm = math.sqrt(mx * mx + my * my + mz * mz)
    return (sine * mx + cos * mz) / norm, mz / norm


@compiled
def pass_and_return(
    cosines: FloatArray, alpha: float, eta: float, distribution: int, points: FloatArray, passing: bool, out: FloatArray
) -> None:
    """Share (1 − F) G₁ let through, or F G₁ thrown back, averaged over the visible normals, for each cosine."""
    for k in range(cosines.size):
        mu = cosines[k]
        total = weight = 0.0
        for a in range(points.shape[0]):
            dot, z = visible_normal(mu, alpha, distribution, points[a, 0], points[a, 1])
            if dot <= 0.0 or z <= 0.0:
                continue
            share = points[a, 2] if distribution == GGX else points[a, 2] * dot / z
            weight += share
            f = dielectric(dot, eta)
            if not passing:
                up = 2.0 * dot * z - mu
                if up > 0.0:
                    total += share * f / (1.0 + smith_lambda(up, alpha, distribution))
            elif f < 1.0:
                inner = max(1.0 - (1.0 - dot * dot) / (eta * eta), 0.0)
                down = mu / eta - z * (dot / eta - math.sqrt(inner))
                if down > 0.0:
                    total += share * (1.0 - f) / (1.0 + smith_lambda(min(down, 1.0), alpha, distribution))
        out[k] = total / weight


def disc(order: int) -> FloatArray:
    """Gauss–Legendre nodes of the square on the unit disc (Shirley & Chiu 1997), the half with p > 0: (n, 3) p, q, w.

    One bounce does not tell p from −p.
    """
    nodes, weights = np.polynomial.legendre.leggauss(order)
    x, y = np.meshgrid(nodes, nodes, indexing="ij")
    w = np.outer(weights, weights)
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    with np.errstate(invalid="ignore", divide="ignore"):
        phi = np.where(wide, math.pi / 4 * y / x, math.pi / 2 - math.pi / 4 * x / y)
    phi = np.where(radius == 0, 0.0, phi)
    p, q = radius * np.cos(phi), radius * np.sin(phi)
    keep = p > 0
    return np.ascontiguousarray(np.stack([p[keep], q[keep], w[keep]], axis=1))


def slopes(order: int) -> FloatArray:
    """Quadrature over the slopes of a Beckmann surface of unit roughness: (n, 3) along, across and weight."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    radius = np.sqrt(-np.log1p(-0.5 * (nodes + 1.0)))
    phi = (np.arange(order) + 0.5) * math.pi / order  # half the circle: one bounce does not tell across from −across
    r, p = np.meshgrid(radius, phi, indexing="ij")
    return np.stack([(r * np.cos(p)).ravel(), (r * np.sin(p)).ravel(), np.repeat(weights, order)], axis=1)


@lru_cache(maxsize=8)
def _points(distribution: int, order: int) -> FloatArray:
    return disc(order) if distribution == GGX else slopes(order)


@lru_cache(maxsize=256)
def coating(alpha: float, eta: float, distribution: int) -> tuple[FloatArray, float]:
    """Transmittance (64,) from outside at equal steps of the cosine, and the mean internal reflectance of the base.

    Parameters
    ----------
    alpha, eta
        Roughness and relative refractive index (inside over outside).
    distribution
        GGX or BECKMANN of `livlab.brdf.models.codes`.
    """
    # The renderer places its table like this, ends off 0 and 1.
    cosines = np.linspace(1e-6, 1.0 - 1e-6, TABLE_SIZE)
    table, inside = np.empty(TABLE_SIZE), np.empty(TABLE_SIZE)
    for index, passing, out in ((eta, True, table), (1.0 / eta, False, inside)):
        points = _points(distribution, ORDER_OUTSIDE if index > 1.0 else ORDER_INSIDE)
        pass_and_return(cosines, alpha, index, distribution, points, passing, out)
    return table, float(np.mean(inside * cosines) * 2.0)


@lru_cache(maxsize=16)
def quick_coating(eta: float, distribution: int, low: float, high: float) -> FloatArray:
    """Chebyshev coefficients (24, 65) in ln alpha over [low, high] of the table and the internal reflectance.

    For searches: 1e-5 of the table, 6e-4 of the internal reflectance, whose own quadrature scatters by as much.
    """
    nodes = np.cos(math.pi * (np.arange(QUICK_NODES) + 0.5) / QUICK_NODES)
    alphas = np.exp(math.log(low) + 0.5 * math.log(high / low) * (nodes + 1.0))
    exact = [coating(float(a), eta, distribution) for a in alphas]
    values = np.array([np.append(table, inside) for table, inside in exact])
    return np.asarray(np.polynomial.chebyshev.chebfit(nodes, values, QUICK_NODES - 1))


def quick_value(coefficients: FloatArray, alpha: float, low: float, high: float) -> tuple[FloatArray, float]:
    """`coating` from `quick_coating`."""
    x = 2.0 * math.log(alpha / low) / math.log(high / low) - 1.0
    found = np.asarray(np.polynomial.chebyshev.chebval(x, coefficients), dtype=np.float64)
    return np.ascontiguousarray(found[:-1]), float(found[-1])
