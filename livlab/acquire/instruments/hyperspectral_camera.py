"""A camera along the normal over a surface in broad, directed light."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from livlab.acquire.instruments.base import Edge, ReferenceCase, VirtualInstrument, cone_readout
from livlab.model.transport.geometry import Readout
from livlab.model.transport.source import Source
from livlab.units import FloatArray


class HyperspectralCamera(VirtualInstrument):
    """A camera along the normal over a surface in broad, directed light.

    Reads the radiance factor in a cone about the normal, as `Collinear`, of an endless sample in even light.
    Crossed polarisers take out the surface's mirror reflection. They would also take out most of what was
    scattered once, which keeps its polarisation; the scalar walk cannot tell, and keeps it: an upper estimate.
    """

    kind: Literal["hyperspectral-camera"] = "hyperspectral-camera"
    illumination_deg: float = Field(45.0, ge=0.0, lt=90.0, description="Angle of incidence: 45, or near 0 (assumed).")
    polarisation: Literal["none", "crossed"] = Field("none", description="Crossed polarisers, or none (assumed).")
    acceptance_deg: float = Field(
        20.0, gt=0.0, le=90.0, description="Half-angle of the cone seen (assumed; wider than a lens's, for less noise)."
    )

    def readout(self, n_above: FloatArray) -> Readout:
        """The flux within the cone about the normal, over sin²(acceptance)."""
        # Even light on an endless surface, seen at one place: by reciprocity a pencil, seen everywhere.
        source = Source.collimated(math.radians(self.illumination_deg))
        return cone_readout(source, self.acceptance_deg, None, specular=self.polarisation == "none")

    def edges(self) -> tuple[Edge, ...]:
        """None: the sample is endless."""
        return ()

    def endless(self) -> HyperspectralCamera:
        """Itself."""
        return self

    @property
    def lateral_distance(self) -> str:
        """None: the light is even."""
        return ""

    def endless_notes(self) -> list[str]:
        """None: it sees an endless sample in any case."""
        return []

    @classmethod
    def cases(cls) -> tuple[ReferenceCase, ...]:
        """Published reflectances in the whole hemisphere, the cone about the normal, and the mirror reflection."""
        from livlab.acquire.instruments import reference

        crossed = cls(illumination_deg=0.0, polarisation="crossed", acceptance_deg=90.0)
        plain = cls(illumination_deg=0.0, acceptance_deg=90.0)
        oblique = cls(illumination_deg=60.0, acceptance_deg=90.0)
        narrow = cls(illumination_deg=0.0, acceptance_deg=2.0)
        mirror = cls(illumination_deg=0.0, acceptance_deg=20.0)
        return (
            ReferenceCase("Giovanelli 1955, diffuse part", crossed, reference.GLOSSY, 2e-6, reference.glossy()),
            ReferenceCase("Giovanelli 1955", plain, reference.GLOSSY + 0.04, 2e-6, reference.glossy()),
            ReferenceCase("van de Hulst 1980, 60°", oblique, reference.OBLIQUE, 1e-5, reference.oblique()),
            ReferenceCase(
                "Chandrasekhar 1960: (a/8) H(1)² along the normal",
                narrow,
                reference.normal_radiance_factor(),
                5e-4,
                reference.half_space(),
            ),
            ReferenceCase(
                "Fresnel: 0.04 within the cone",
                mirror,
                0.04 / math.sin(math.radians(20.0)) ** 2,
                1e-6,
                reference.black_glass(),
            ),
            ReferenceCase("a Lambertian reads its albedo", cls(), 0.37, 1e-12, light=reference.lambertian(0.37)),
        )
