"""Light and sensor along the normal over a square sample."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from livlab.acquire.instruments.base import (
    Edge,
    Extent,
    ReferenceCase,
    VirtualInstrument,
    cone_readout,
    half_mm,
    sample_note,
)
from livlab.model.transport.geometry import Readout
from livlab.model.transport.source import Source
from livlab.units import FloatArray


class Collinear(VirtualInstrument):
    """Light and sensor along the normal over a square sample (Nunes 2019, Fig. 7.1).

    Reads the radiance factor: the flux that leaves the lit face within the sensor's cone, over sin²(acceptance)
    times the incident flux, so that a Lambertian of albedo ρ reads ρ at any acceptance. What leaves through the
    sample's sides is lost, and counted.
    """

    kind: Literal["collinear"] = "collinear"
    sample_side_mm: Extent = Field(10.0, description="Side of the square sample in mm, or 'infinite'; 1 cm² (thesis).")
    beam: Literal["face", "pencil"] = Field(
        "face", description="Light over the whole face, or on its middle (assumed: the thesis says collinear only)."
    )
    acceptance_deg: float = Field(
        30.0, gt=0.0, le=90.0, description="Half-angle of the sensor's cone (assumed: a fibre of aperture 0.5)."
    )
    specular: Literal["excluded", "included"] = Field(
        "excluded",
        description="Mirror reflection of the surface, which a flat sample sends straight back (assumed excluded).",
    )

    def readout(self, n_above: FloatArray) -> Readout:
        """The flux within the sensor's cone, over sin²(acceptance)."""
        half = half_mm(self.sample_side_mm)
        face = half or 0.0 if self.beam == "face" else 0.0
        source = Source.collimated(square_half_width_mm=face)
        return cone_readout(source, self.acceptance_deg, half, specular=self.specular == "included")

    def edges(self) -> tuple[Edge, ...]:
        """The sample's sides."""
        half = half_mm(self.sample_side_mm)
        return () if half is None else (Edge(half, 4, half, self.beam == "face"),)

    def endless(self) -> Collinear:
        """The same over an endless sample."""
        return self.model_copy(update={"sample_side_mm": "infinite"})

    @property
    def lateral_distance(self) -> str:
        """None."""
        return ""

    def endless_notes(self) -> list[str]:
        """That nothing is lost through the sides."""
        return sample_note(self.sample_side_mm)

    @classmethod
    def cases(cls) -> tuple[ReferenceCase, ...]:
        """A Lambertian, the cone about the normal, and samples too wide and too narrow for their sides to tell."""
        from livlab.acquire.instruments import reference

        wide = cls(sample_side_mm="infinite", acceptance_deg=90.0)
        narrow = cls(sample_side_mm="infinite", acceptance_deg=2.0)
        pencil = cls(sample_side_mm=20.0, beam="pencil", acceptance_deg=90.0)
        needle = cls(sample_side_mm=0.002, beam="pencil", acceptance_deg=90.0)
        return (
            ReferenceCase("a Lambertian reads its albedo", cls(), 0.37, 1e-12, light=reference.lambertian(0.37)),
            ReferenceCase("van de Hulst 1980, slab", wide, reference.SLAB, 2e-6, reference.slab()),
            ReferenceCase(
                "Chandrasekhar 1960: (a/8) H(1)² along the normal",
                narrow,
                reference.normal_radiance_factor(),
                5e-4,
                reference.half_space(),
            ),
            ReferenceCase(
                "the slab, far from its sides", pencil, reference.SLAB, 4e-3, reference.slab(), samples=200_000
            ),
            ReferenceCase("a needle: its sides take all", needle, 0.0, 4e-3, reference.slab(), samples=50_000),
        )
