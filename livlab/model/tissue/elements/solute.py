"""A chromophore in solution by its molar extinction, bilirubin for one (Beer and Lambert)."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field

from livlab.model.tissue import chromophores
from livlab.model.tissue.elements.base import (
    Absorber,
    Amount,
    MovableAbsorption,
    Omission,
    ReferenceValue,
    Slider,
)
from livlab.model.tissue.setting import Setting
from livlab.model.tissue.spectra import Extinction
from livlab.units import FloatArray


class Solute(Absorber):
    """A chromophore in solution, by its molar extinction: µa = ln(10) ε c (Beer and Lambert); bilirubin for one."""

    kind: Literal["solute"]
    concentration_umol_per_l: Amount = Field(description="Concentration c in the layer's own volume, in µmol/L.")
    spectrum: Extinction = Field(description="Its molar extinction ε, to the base 10.")

    units: ClassVar[dict[str, str]] = {"concentration_umol_per_l": "µmol/L"}

    def dataset_names(self) -> tuple[str, ...]:
        """The extinction's datasets."""
        return self.spectrum.datasets

    def absorption(self, setting: Setting) -> FloatArray:
        """ln(10) ε c."""
        extinction = self.spectrum.per_mm_per_mol_per_l(setting.wavelength_nm, setting.note)
        return chromophores.solute(self.concentration_umol_per_l, extinction)

    def omissions(self) -> tuple[Omission, ...]:
        """None."""
        return ()

    def movable_absorption(self, name: str, setting: Setting) -> MovableAbsorption:
        """By its concentration."""
        key, now = "concentration_umol_per_l", self.concentration_umol_per_l
        unit = self.model_copy(update={key: 1.0}).absorption(setting)
        high = 3.0 * now if now > 0 else 100.0
        return MovableAbsorption(
            formula="pigment",
            data={"key": key, "spectrum": unit},
            sliders=(Slider(key, name.replace("_", " "), 0.0, high, now, unit="µmol/L"),),
            now=now * unit,
        )

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Oxyhaemoglobin at 540 nm."""
        return (
            ReferenceValue(
                source="ln 10 · 53236 1/(cm M) (Prahl 1999, 540 nm) · 20 µmol/L",
                element={
                    "concentration_umol_per_l": 20.0,
                    "spectrum": {"datasets": ["haemoglobin_prahl"], "column": "hbo2"},
                },
                wavelength_nm=540.0,
                rate=math.log(10.0) * 5323.6 * 20e-6,
                albedo=0.0,
            ),
        )
