"""A tissue layer as transfer theory sees it: two coefficients and the moments of one phase function."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np

from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.stack import REDIRECT_MEAN, PlaneLayer
from livlab.units import FloatArray


@dataclass(frozen=True)
class LayerOptics:
    """One layer at one wavelength: mm, 1/mm, and the moments of its phase function."""

    n: float
    thickness: float
    absorption: float
    scattering: float
    moments: FloatArray


class Moments:
    """Legendre moments of phase functions, each asked once, cut where they have died out."""

    def __init__(self, highest: int, negligible: float) -> None:
        self.highest = highest
        self.negligible = negligible
        self.worst_peak = 0.0
        self._known: dict[int, tuple[Phase, FloatArray]] = {}

    def of(self, phase: Phase) -> FloatArray:
        """χ_0 … χ_L."""
        known = self._known.get(id(phase))
        if known is None:
            known = self._known[id(phase)] = (phase, self._ask(phase))
        return known[1]

    def _ask(self, phase: Phase) -> FloatArray:
        try:
            return _kept(cast(Hashable, phase), self.highest, self.negligible)
        except TypeError:  # a phase function that cannot be a key
            return _asked(phase, self.highest, self.negligible)

    def layer(self, parts: list[tuple[float, Phase]]) -> tuple[float, FloatArray]:
        """Scattering that is left and moments of a mixture; a peak beyond the highest order counts as unscattered."""
        scattering = math.fsum(w for w, _ in parts)
        chis = [(w / scattering, self.of(p)) for w, p in parts]
        chi = np.zeros(max(len(c) for _, c in chis))
        for weight, c in chis:
            chi[: len(c)] += weight * c
        chi[0] = 1.0
        if len(chi) > self.highest and chi[-1] > 0:
            peak = float(chi[-1])
            self.worst_peak = max(self.worst_peak, peak)
            return scattering * (1 - peak), (chi[:-1] - peak) / (1 - peak)
        return scattering, chi


def _asked(phase: Phase, highest: int, negligible: float) -> FloatArray:
    """Moments until they stay below `negligible`, at most up to `highest`."""
    ask = min(32, highest)
    while True:
        chi = np.asarray(phase.legendre(ask), dtype=np.float64)
        last = int(np.flatnonzero(np.abs(chi) > negligible)[-1])
        if last <= 0.75 * ask or ask == highest:
            return chi[: last + 1]
        ask = min(2 * ask, highest)


_kept = lru_cache(maxsize=512)(_asked)


def layer_optics(layer: PlaneLayer, index: int, n: float, moments: Moments) -> LayerOptics:
    """A layer's coefficients at one wavelength, the short free paths' absorption included."""
    absorption, parts = _rates(layer, index)
    scattering, chi = moments.layer(parts) if parts else (0.0, np.ones(1))
    return LayerOptics(n, layer.thickness_mm, absorption, scattering, chi)


def reduced_coefficients(layer: PlaneLayer) -> tuple[FloatArray, FloatArray]:
    """(W,) µ_a and µ_s' = Σ µ_s (1 − g) in 1/mm, short free paths as in `layer_optics`."""
    absorption, reduced = np.zeros(len(layer.n)), np.zeros(len(layer.n))
    for k in range(len(layer.n)):
        absorption[k], parts = _rates(layer, k)
        reduced[k] = math.fsum(rate * (1.0 - phase.anisotropy) for rate, phase in parts)
    return absorption, reduced


def _rates(layer: PlaneLayer, index: int) -> tuple[float, list[tuple[float, Phase]]]:
    """Absorption, and the scattering of each element that has any, at one wavelength."""
    extinction = math.fsum(float(i.rate[index]) for i in layer.interactions)
    absorption, parts = [], []
    for i in layer.interactions:
        rate = float(i.rate[index])
        long_path = math.exp(-extinction * i.absorb_below_mm)
        albedo = float(i.albedo[index]) * REDIRECT_MEAN[i.redirect]
        absorption.append(rate * (1.0 - albedo))
        absorption.append(rate * albedo * -math.expm1(-extinction * i.absorb_below_mm))
        if rate * albedo * long_path > 0:
            parts.append((rate * albedo * long_path, i.phases[index]))
    return math.fsum(absorption), parts
