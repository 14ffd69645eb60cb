"""A source fibre and a detector fibre at a distance on an endless surface."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from livlab.acquire.instruments.base import Edge, ReferenceCase, VirtualInstrument
from livlab.errors import InputError
from livlab.model.transport.geometry import Readout
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

PROBE_BINS = 48
"""Rings about the source in which the light that leaves is counted."""


class FibreProbe(VirtualInstrument):
    """A source fibre and a detector fibre at a distance, both upright on an endless surface.

    Reads the share of the launched light that enters the detector fibre within its aperture. The light is
    launched upright (assumed), and the surface between the fibres meets the stack's medium above.
    """

    kind: Literal["fibre-probe"] = "fibre-probe"
    distance_mm: float = Field(1.0, gt=0.0, le=1e3, description="Between the fibres' axes.")
    source_radius_mm: float = Field(0.1, ge=0.0, le=1e2, description="Radius of the source fibre's core (assumed).")
    fibre_radius_mm: float = Field(0.1, gt=0.0, le=1e2, description="Radius of the detector fibre's core (assumed).")
    numerical_aperture: float = Field(0.22, gt=0.0, le=2.0, description="Of the detector fibre (assumed).")

    @model_validator(mode="after")
    def _apart(self) -> FibreProbe:
        if self.distance_mm < self.source_radius_mm + self.fibre_radius_mm:
            raise InputError.of(
                "distance_mm",
                self.distance_mm,
                f"must be at least the radii together ({self.source_radius_mm + self.fibre_radius_mm:g} mm)",
                "Two fibres cannot overlap.",
            )
        return self

    def readout(self, n_above: FloatArray) -> Readout:
        """Rings about the source, weighed by their overlap with the detector, within its aperture."""
        n = float(np.mean(n_above))
        notes = []
        if np.ptp(n_above) > 1e-3 * n:
            notes.append("the probe's cone is that of the mean index above: it varies by more than 0.1 % over the band")
        sine = self.numerical_aperture / n
        reach = self.source_radius_mm + self.fibre_radius_mm
        edges = np.linspace(max(0.0, self.distance_mm - reach), self.distance_mm + reach, PROBE_BINS + 1)
        return Readout(
            Source.collimated(),
            Tally(
                theta_edges=() if sine >= 1.0 else (0.0, math.asin(sine)),
                radius_edges=tuple(float(x) for x in edges),
            ),
            None,
            probe_weights(self, edges)[None, :],
            0.0,
            False,
            tuple(notes),
        )

    def edges(self) -> tuple[Edge, ...]:
        """None: the surface is endless."""
        return ()

    def endless(self) -> FibreProbe:
        """Itself."""
        return self

    @property
    def lateral_distance(self) -> str:
        """That of the fibres."""
        return "distance between fibres"

    def endless_notes(self) -> list[str]:
        """None: it cannot be read by adding–doubling."""
        return []

    @classmethod
    def cases(cls) -> tuple[ReferenceCase, ...]:
        """How fibres overlap with an even exitance and with a ring."""
        from livlab.acquire.instruments import reference

        wide, narrow = cls(numerical_aperture=1.0), cls(numerical_aperture=0.22)
        thin = cls(source_radius_mm=0.0, numerical_aperture=1.0)
        even = reference.lambertian(1.0)
        area = math.pi * wide.fibre_radius_mm**2
        share = 2.0 * math.asin(0.5 * thin.fibre_radius_mm / thin.distance_mm) / math.pi
        return (
            ReferenceCase("even light of 1/mm²: the core's area", wide, area, 2e-4 * area, light=even),
            ReferenceCase("the same within the aperture", narrow, area * 0.22**2, 2e-4 * area * 0.22**2, light=even),
            ReferenceCase(
                "a ring through the detector's middle: its arc within",
                thin,
                share,
                1e-3 * share,
                light=reference.ring(thin.distance_mm),
            ),
        )


def probe_weights(probe: FibreProbe, edges_mm: FloatArray) -> FloatArray:
    """(R,) chance that light which leaves at a distance from where it entered hits the detector fibre.

    Light enters evenly over the source fibre and leaves at distance r in any direction alike, so the chance is
    the mean over that direction of the overlap of the detector with the source fibre moved by r. It is averaged
    over each bin, as if the flux were even within it.

    Parameters
    ----------
    probe
        The fibres.
    edges_mm
        (R + 1,) rising distances.
    """
    nodes, node_weights = np.polynomial.legendre.leggauss(6)
    low, high = edges_mm[:-1, None], edges_mm[1:, None]
    r = (low + high) / 2 + (high - low) / 2 * nodes
    d, a, s = probe.distance_mm, probe.fibre_radius_mm, probe.source_radius_mm
    if s == 0.0:
        cosine = (d * d + r * r - a * a) / np.maximum(2 * d * r, np.finfo(float).tiny)
        chance = np.arccos(np.clip(cosine, -1.0, 1.0)) / math.pi
    else:
        # Only directions within ±widest can reach the detector; midpoints of 400 equal parts of that range.
        widest = math.asin(min(1.0, (a + s) / d)) if d > a + s else math.pi / 2
        phi = (np.arange(400) + 0.5) / 400 * widest
        apart = np.sqrt(np.maximum(d * d + r[..., None] ** 2 - 2 * d * r[..., None] * np.cos(phi), 0.0))
        chance = _overlap(apart, a, s).mean(axis=-1) / (math.pi * s * s) * widest / math.pi
    return np.asarray(chance @ node_weights / 2, dtype=np.float64)


def _overlap(apart: FloatArray, a: float, b: float) -> FloatArray:
    """Area that two discs of radii a and b share, their centres `apart`."""
    full = math.pi * min(a, b) ** 2
    x = np.clip(apart, max(abs(a - b), 1e-300), a + b)
    first = np.arccos(np.clip((x * x + a * a - b * b) / (2 * x * a), -1.0, 1.0))
    second = np.arccos(np.clip((x * x + b * b - a * a) / (2 * x * b), -1.0, 1.0))
    kite = np.sqrt(np.maximum((-x + a + b) * (x + a - b) * (x - a + b) * (x + a + b), 0.0)) / 2
    area = a * a * first + b * b * second - kite
    return np.where(apart >= a + b, 0.0, np.where(apart <= abs(a - b), full, area))
