"""A pigment by the measured absorption of the pure substance, bile for one (Nunes 2019, eq. 6.15)."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from livlab.model.tissue.elements.base import (
    Absorber,
    Budget,
    MovableAbsorption,
    Omission,
    ReferenceValue,
    Share,
    Slider,
)
from livlab.model.tissue.setting import Setting
from livlab.model.tissue.spectra import AbsorptionSpectrum
from livlab.units import FloatArray


class Pigment(Absorber):
    """A pigment with a measured absorption, bile for one (Nunes 2019, eq. 6.15)."""

    kind: Literal["pigment"]
    fraction: Share = Field(description="Volume fraction.")
    spectrum: AbsorptionSpectrum = Field(description="Its absorption, pure.")

    budget: ClassVar[Budget] = "composition"
    units: ClassVar[dict[str, str]] = {"fraction": "1"}

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.fraction

    def dataset_names(self) -> tuple[str, ...]:
        """The spectrum's datasets."""
        return self.spectrum.datasets

    def absorption(self, setting: Setting) -> FloatArray:
        """F σ."""
        return self.fraction * self._pure(setting)

    def omissions(self) -> tuple[Omission, ...]:
        """None."""
        return ()

    def movable_absorption(self, name: str, setting: Setting) -> MovableAbsorption:
        """By its fraction."""
        pure = self._pure(setting)
        return MovableAbsorption(
            formula="pigment",
            data={"spectrum": pure},
            sliders=(Slider("fraction", f"{name.replace('_', ' ')} fraction", 0.0, 0.1, self.fraction),),
            now=self.fraction * pure,
        )

    def _pure(self, setting: Setting) -> FloatArray:
        return self.spectrum.per_mm(setting.wavelength_nm, setting.note)

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Pope & Fry's water."""
        return (
            ReferenceValue(
                source="Pope & Fry 1997, Table 3: 0.624 1/m at 700 nm",
                element={"fraction": 0.65, "spectrum": {"datasets": ["water_pope_fry1997"]}},
                wavelength_nm=700.0,
                rate=0.65 * 0.624e-3,
                albedo=0.0,
            ),
        )
