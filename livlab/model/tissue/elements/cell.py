"""Spheroidal cells, hepatocytes for one: Nunes 2019, eq. 6.16, 6.17, 6.19, and what the readings make of them."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from livlab.model.tissue.elements.base import (
    Anisotropy,
    Budget,
    Derived,
    Length,
    MovableScattering,
    ReferenceValue,
    Remarks,
    Scatterer,
    Share,
)
from livlab.model.tissue.particles import spheroid
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.readings import Reading, Subject
from livlab.model.tissue.setting import Setting, scatterer
from livlab.model.tissue.stack import Interaction
from livlab.units import per_mm_to_per_cm, um_to_mm


class Cell(Scatterer):
    """Spheroidal cells of two diameters, hepatocytes for one (Nunes 2019, eq. 6.16, 6.17)."""

    kind: Literal["cell"]
    fraction: Share = Field(description="Volume fraction.")
    a_um: Length = Field(description="Diameter across in µm: the two equal ones.")
    b_um: Length = Field(description="Diameter along in µm: the third one.")
    albedo: Share = Field(1.0, description="Single-scattering albedo.")
    anisotropy: Anisotropy = Field(description="g of its Henyey–Greenstein phase function.")

    budget: ClassVar[Budget] = "structure"
    units: ClassVar[dict[str, str]] = {"fraction": "1", "a_um": "µm", "b_um": "µm", "albedo": "1", "anisotropy": "1"}

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.fraction

    def dataset_names(self) -> tuple[str, ...]:
        """None."""
        return ()

    def interaction(self, name: str, setting: Setting) -> Interaction:
        """Rate σ_t or the penalised one (eq. 6.19); absorbed by an albedo, or on a short free path (Algorithm 1)."""
        reading = setting.reading
        one = np.ones_like(setting.wavelength_nm)
        sigma = self.attenuation_per_mm(reading) * one
        rate = spheroid.penalised_rate(sigma) if reading.hepatocyte_rate == "log10" else sigma
        more: dict[str, Any] = {"albedo": self.albedo * one}
        if reading.hepatocyte_absorption == "free_path":
            more = {"absorb_below_mm": um_to_mm(0.5 * (self.a_um + self.b_um))}
        return scatterer(name, rate, lambda: (HenyeyGreenstein(self.anisotropy),) * len(one), setting, **more)

    def attenuation_per_mm(self, reading: Reading) -> float:
        """σ_t in 1/mm (Nunes 2019, eq. 6.16), from the diameters as printed or from the semi-axes."""
        shrink = 1.0 if reading.hepatocyte_axes == "diameters" else 0.5
        return spheroid.attenuation(um_to_mm(shrink * self.a_um), um_to_mm(shrink * self.b_um), self.fraction)

    def subjects(self) -> tuple[Subject, ...]:
        """Cells."""
        return ("cells",)

    def remarks(self, reading: Reading) -> Remarks:
        """What the penalised free path does, and σ_t for the table."""
        sigma = per_mm_to_per_cm(self.attenuation_per_mm(reading))
        penalised = "Cells: the penalised free path (eq. 6.19) makes more cells scatter less."
        return Remarks(
            walk=(penalised,) if reading.hepatocyte_rate == "log10" else (),
            derived=(
                Derived("geometric attenuation", sigma, "1/cm", f"Nunes 2019, eq. 6.16, {reading.hepatocyte_axes}"),
            ),
        )

    def movable_scattering(self) -> MovableScattering:
        """By the fraction; shadows have no exponent."""
        return MovableScattering(tilts=False, formula="cell", key="fraction", data={"fraction": self.fraction})

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """A sphere's shadow, which is a circle: 3 f/(4 r); and half of it where diameters stand for semi-axes."""
        element = {"fraction": 0.1, "a_um": 20.0, "b_um": 20.0, "albedo": 0.9, "anisotropy": 0.8}
        return (
            ReferenceValue(
                source="spheres of 20 µm: f π r²/(4/3 π r³)",
                element=element,
                rate=0.1 * 0.75 / 0.010,
                albedo=0.9,
                anisotropy=0.8,
            ),
            ReferenceValue(
                source="the same with r = 20 µm (row 8 of the table of contradictions)",
                element=element,
                reading=("consistent", {"hepatocyte_axes": "diameters"}),
                rate=0.1 * 0.75 / 0.020,
                albedo=0.9,
                anisotropy=0.8,
            ),
        )
