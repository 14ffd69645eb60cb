"""An absorber whose spectrum is a formula: melanin, bloodless skin."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from livlab.errors import InputError
from livlab.model.tissue import chromophores
from livlab.model.tissue.elements.base import (
    Absorber,
    Amount,
    Budget,
    Length,
    MovableAbsorption,
    Omission,
    ReferenceValue,
    Share,
    Slider,
)
from livlab.model.tissue.setting import Setting
from livlab.units import FloatArray, per_cm_to_per_mm


class LawAbsorber(Absorber):
    """An absorber with an analytic spectrum: f (s (λ/λ0)^−p + o), or f (s e^(−(λ−λ0)/d) + o); melanin for one."""

    kind: Literal["law_absorber"]
    fraction: Share = Field(description="Volume fraction f.")
    law: Literal["power", "exponential"] = Field(description="Form of the spectrum.")
    scale_per_cm: Amount = Field(description="Absorption s at the reference wavelength in 1/cm.")
    reference_nm: Length = Field(description="Reference wavelength λ0 in nm.")
    exponent: float | None = Field(None, description="Exponent p of the power law.")
    decay_nm: Length | None = Field(None, description="Decay d of the exponential in nm.")
    offset_per_cm: Amount = Field(0.0, description="Constant o in 1/cm.")

    budget: ClassVar[Budget] = "composition"
    units: ClassVar[dict[str, str]] = {
        "fraction": "1",
        "scale_per_cm": "1/cm",
        "reference_nm": "nm",
        "exponent": "1",
        "decay_nm": "nm",
        "offset_per_cm": "1/cm",
    }

    @model_validator(mode="after")
    def _own_parameter(self) -> LawAbsorber:
        needed, other = ("exponent", "decay_nm") if self.law == "power" else ("decay_nm", "exponent")
        if getattr(self, needed) is None or getattr(self, other) is not None:
            raise InputError.of("law", self.law, f"needs {needed}, and no {other}", f"Give {needed}.")
        return self

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.fraction

    def dataset_names(self) -> tuple[str, ...]:
        """None."""
        return ()

    def absorption(self, setting: Setting) -> FloatArray:
        """F times the law and its offset."""
        wavelength, scale, at = setting.wavelength_nm, self.scale_per_cm, self.reference_nm
        if self.exponent is not None:
            law = chromophores.power_law(wavelength, scale, self.exponent, at)
        else:
            law = chromophores.exponential_law(wavelength, scale, float(self.decay_nm or math.nan), at)
        return per_cm_to_per_mm(self.fraction * (law + self.offset_per_cm))

    def omissions(self) -> tuple[Omission, ...]:
        """None."""
        return ()

    def movable_absorption(self, name: str, setting: Setting) -> MovableAbsorption:
        """By its fraction: a law's spectrum is what it absorbs over its fraction, so it moves as a table's does."""
        unit = self.with_share(1.0).absorption(setting)
        most = min(1.0, max(0.1, 2.0 * self.fraction))
        return MovableAbsorption(
            formula="pigment",
            data={"spectrum": unit},
            sliders=(Slider("fraction", f"{name.replace('_', ' ')} fraction", 0.0, most, self.fraction),),
            now=self.fraction * unit,
        )

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Jacques's melanosome and bloodless skin, as printed."""
        return (
            ReferenceValue(
                source="Jacques 1998, melanosome: 1.70·10¹² λ^−3.48 in 1/cm",
                element={
                    "fraction": 0.04, "law": "power", "scale_per_cm": 1.70e12, "reference_nm": 1.0, "exponent": 3.48,
                },
                rate=0.1 * 0.04 * 1.70e12 * math.exp(-3.48 * math.log(500.0)),
                albedo=0.0,
            ),
            ReferenceValue(
                source="Jacques 1998, bloodless skin: 0.244 + 85.3 e^(−(λ − 154)/66.2) in 1/cm",
                element={
                    "fraction": 0.96, "law": "exponential", "scale_per_cm": 85.3, "reference_nm": 154.0,
                    "decay_nm": 66.2, "offset_per_cm": 0.244,
                },
                rate=0.1 * 0.96 * (0.244 + 85.3 * math.exp(-346.0 / 66.2)),
                albedo=0.0,
            ),
        )  # fmt: skip
