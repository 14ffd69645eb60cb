"""What instruments look at where the reading is known: textbook stacks with their values, and light given as it leaves.

Values are reflectances for collimated light, without the mirror reflection of the surface unless said, of an
adding–doubling that agrees to seven digits with the exact H function, with van de Hulst (1980) and Giovanelli (1955).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import OpticalStack, plain_stack
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

SLAB = 0.0973946
"""Of `slab`, upright light; van de Hulst (1980): .09739."""

GLOSSY = 0.2199186
"""Of `glossy`, upright light; with the specular 0.04 Giovanelli (1955) has .2600."""

CAPSULE = 0.1217318 + 0.0232692
"""Of `capsule`, upright light, with the mirror reflection."""

OBLIQUE = 0.61996
"""Of `oblique` at 60°, by van de Hulst (1980)."""

HALF_SPACE = 0.4149475
"""Of `half_space`, upright light: 1 − H(1) √(1 − a) with a = 0.9."""


def slab() -> OpticalStack:
    """Matched index, µa 1/mm, µs 9/mm, g 0.75, 0.2 mm."""
    return plain_stack([(1.0, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))])


def glossy() -> OpticalStack:
    """A half-space of index 1.5 that scatters isotropically, albedo 0.9."""
    return plain_stack([(1.5, 1.0, 9.0, math.inf, Isotropic())])


def capsule() -> OpticalStack:
    """0.1 mm of index 1.36 over a half-space of index 1.38, thick enough at 50 mm."""
    forward = HenyeyGreenstein(0.9)
    return plain_stack([(1.36, 0.01, 10.0, 0.1, forward), (1.38, 0.5, 15.0, 50.0, forward)])


def oblique() -> OpticalStack:
    """Matched index, albedo 0.99, optical depth 4, g 0.5."""
    return plain_stack([(1.0, 0.01, 0.99, 4.0, HenyeyGreenstein(0.5))])


def half_space() -> OpticalStack:
    """Matched index, isotropic scattering, albedo 0.9."""
    return plain_stack([(1.0, 1.0, 9.0, math.inf, Isotropic())])


def black_glass() -> OpticalStack:
    """A half-space of index 1.5 that only absorbs."""
    return plain_stack([(1.5, 1.0, 0.0, math.inf, Isotropic())])


def normal_radiance_factor() -> float:
    """π L / E of `half_space`, lit and seen along the normal: (a/8) H(1)² (Chandrasekhar 1960, ch. V)."""
    albedo = 0.9
    return albedo / 8.0 * ((1.0 - HALF_SPACE) / math.sqrt(1.0 - albedo)) ** 2


def lambertian(amount: float) -> Callable[[Tally], FloatArray]:
    """(θ, r) flux of a Lambertian: `amount` in all, or for each mm² where the tally tells distances apart."""

    def light(tally: Tally) -> FloatArray:
        share = np.diff(np.square(np.sin(tally.theta)))
        area = math.pi * np.diff(np.square(tally.radius)) if tally.radius_edges else np.ones(1)
        return np.asarray(amount * share[:, None] * area)

    return light


def ring(radius_mm: float) -> Callable[[Tally], FloatArray]:
    """(θ, r) flux of 1 that leaves in every direction at one distance, as a Lambertian; half on either side of it."""

    def light(tally: Tally) -> FloatArray:
        edges = np.asarray(tally.radius)
        around = np.array([(edges[:-1] < r) & (r <= edges[1:]) for r in radius_mm * np.array([1 - 1e-9, 1 + 1e-9])])
        share = np.diff(np.square(np.sin(tally.theta)))
        return np.asarray(share[:, None] * around.mean(axis=0))

    return light
