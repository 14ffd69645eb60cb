"""Total diffuse reflectance through the port of an integrating sphere."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from livlab.acquire.instruments.base import (
    Edge,
    Extent,
    ReferenceCase,
    VirtualInstrument,
    half_mm,
    length_mm,
    sample_note,
)
from livlab.errors import InputError
from livlab.model.transport.geometry import Readout
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray


class IntegratingSphere(VirtualInstrument):
    """Total diffuse reflectance through the port of an integrating sphere, light from near the normal.

    Reads the flux that leaves within the port over the incident flux; what surfaces outside the port is missed.
    By reciprocity also what a sphere with diffuse light and a sensor at that angle reads. The sphere's own
    multiple reflections are taken as calibrated away.
    """

    kind: Literal["integrating-sphere"] = "integrating-sphere"
    sample_side_mm: Extent = Field("infinite", description="Side of the square sample in mm, or 'infinite'.")
    port_diameter_mm: Extent = Field(20.0, description="Diameter of the sample port in mm, or 'infinite' (assumed).")
    beam_diameter_mm: float = Field(5.0, ge=0.0, le=1e4, description="Diameter of the beam; 0: a pencil (assumed).")
    incidence_deg: float = Field(8.0, ge=0.0, lt=90.0, description="Angle of incidence (8/d geometry).")
    specular: Literal["excluded", "included"] = Field("included", description="Gloss trap open or closed.")

    @model_validator(mode="after")
    def _fits(self) -> IntegratingSphere:
        room = min(length_mm(self.port_diameter_mm), length_mm(self.sample_side_mm))
        if self.beam_diameter_mm > room:
            raise InputError.of(
                "beam_diameter_mm",
                self.beam_diameter_mm,
                f"must not exceed the port or sample ({room:g} mm)",
                "Narrow it.",
            )
        if self.port_diameter_mm != "infinite" and length_mm(self.sample_side_mm) < self.port_diameter_mm:
            raise InputError.of(
                "port_diameter_mm", self.port_diameter_mm, "must not exceed the sample's side", "Use a smaller port."
            )
        return self

    def readout(self, n_above: FloatArray) -> Readout:
        """All light that leaves within the port."""
        port = half_mm(self.port_diameter_mm)
        return Readout(
            Source.collimated(math.radians(self.incidence_deg), disc_radius_mm=self.beam_diameter_mm / 2),
            Tally() if port is None else Tally(radius_edges=(0.0, port)),
            half_mm(self.sample_side_mm),
            np.ones((1, 1)),
            float(self.specular == "included"),
            True,
        )

    def edges(self) -> tuple[Edge, ...]:
        """The port's rim, or the sample's sides behind an endless port."""
        rim = self.beam_diameter_mm / 2
        port, side = half_mm(self.port_diameter_mm), half_mm(self.sample_side_mm)
        if port is not None:
            # The sample is no smaller than the port: what passes its sides has passed the port's rim.
            return tuple(Edge(port - rim, m, port * math.cos(math.pi / m) - rim) for m in (4, 8, 16, 32))
        return () if side is None else (Edge(side - rim, 4, side - rim),)

    def endless(self) -> IntegratingSphere:
        """The same with an endless port over an endless sample."""
        return self.model_copy(update={"sample_side_mm": "infinite", "port_diameter_mm": "infinite"})

    @property
    def lateral_distance(self) -> str:
        """None: what matters is only whether light passes the rim."""
        return ""

    def endless_notes(self) -> list[str]:
        """That nothing is lost through the sides, and that nothing misses the port."""
        notes = sample_note(self.sample_side_mm)
        if self.port_diameter_mm != "infinite":
            notes.append(
                f"adding-doubling takes the port of {self.port_diameter_mm:g} mm as endless: nothing misses it"
            )
        return notes

    @classmethod
    def cases(cls) -> tuple[ReferenceCase, ...]:
        """Published reflectances, and ports too wide and too narrow for their rim to tell."""
        from livlab.acquire.instruments import reference

        upright = cls(port_diameter_mm="infinite", incidence_deg=0.0)
        trapped = cls(port_diameter_mm="infinite", incidence_deg=0.0, specular="excluded")
        oblique = cls(port_diameter_mm="infinite", incidence_deg=60.0)
        ported = cls(incidence_deg=0.0, beam_diameter_mm=0.0)
        pinhole = cls(port_diameter_mm=0.002, incidence_deg=0.0, beam_diameter_mm=0.0)
        return (
            ReferenceCase("van de Hulst 1980, slab", upright, reference.SLAB, 2e-6, reference.slab()),
            ReferenceCase("Giovanelli 1955", upright, reference.GLOSSY + 0.04, 2e-6, reference.glossy()),
            ReferenceCase("Giovanelli 1955, diffuse part", trapped, reference.GLOSSY, 2e-6, reference.glossy()),
            ReferenceCase("two layers of unequal index", upright, reference.CAPSULE, 2e-6, reference.capsule()),
            ReferenceCase("van de Hulst 1980, 60°", oblique, reference.OBLIQUE, 1e-5, reference.oblique()),
            ReferenceCase(
                "the slab, far from the rim", ported, reference.SLAB, 4e-3, reference.slab(), samples=200_000
            ),
            ReferenceCase("a pinhole: all misses it", pinhole, 0.0, 4e-3, reference.slab(), samples=50_000),
        )
