"""How strong a light must be to have its level: the radiance of a white diffuser at the target that faces it.

Irradiance E makes a perfect white diffuser's radiance E/π; so a light of level l gives E = π l at the target.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from livlab.errors import InputError


def point_intensity(level: float, position_mm: ArrayLike, target_mm: ArrayLike) -> float:
    """Radiant intensity I = E d² of a point (or of a spot on its axis).

    >>> round(point_intensity(1.0, (0, 0, 2.0), (0, 0, 0)) / math.pi, 12)
    4.0
    """
    return math.pi * level * _distance(position_mm, target_mm) ** 2


def directional_irradiance(level: float) -> float:
    """Irradiance on a surface that faces parallel light: E = π l."""
    return math.pi * level


def area_radiance(level: float, position_mm: ArrayLike, size_mm: ArrayLike, target_mm: ArrayLike) -> float:
    """Radiance L of a rectangle that faces the target, so that E = L ∫ cos² / d² dA there.

    The view factor from a small surface to a parallel rectangle over it, four times that to a quarter with sides
    a = A d and b = B d: (A atan(B/√(1 + A²))/√(1 + A²) + B atan(A/√(1 + B²))/√(1 + B²))/(2π) (Howell, A Catalog of
    Radiation Heat Transfer Configuration Factors, B-3).

    A rectangle that fills the half-space has the level itself as radiance:

    >>> round(area_radiance(1.0, (0, 0, 1.0), (1e6, 1e6), (0, 0, 0)), 5)
    1.0
    """
    d = _distance(position_mm, target_mm)
    a, b = (float(x) / (2.0 * d) for x in np.asarray(size_mm, dtype=np.float64))
    if not (a > 0 and b > 0):
        raise InputError.of("size_mm", size_mm, "must be > 0", "Give width and height.")
    ra, rb = math.sqrt(1 + a * a), math.sqrt(1 + b * b)
    quarter = (a / ra * math.atan(b / ra) + b / rb * math.atan(a / rb)) / (2 * math.pi)
    return level / (4.0 * quarter)


def _distance(position_mm: ArrayLike, target_mm: ArrayLike) -> float:
    d = float(np.linalg.norm(np.subtract(position_mm, target_mm)))
    if not d > 1e-9:
        raise InputError.of("position_mm", position_mm, "must not be at the target", "Move the light.")
    return d
