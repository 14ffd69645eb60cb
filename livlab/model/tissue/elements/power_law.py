"""Reduced scattering by a power law, or by Rayleigh's and Mie's shares of one (Jacques 2013, eq. 1, 2)."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from livlab.errors import InputError
from livlab.model.tissue import chromophores
from livlab.model.tissue.elements.base import Amount, Length, MovableScattering, ReferenceValue, Share
from livlab.model.tissue.elements.reduced import ReducedScatterer, rayleigh_mie
from livlab.model.tissue.setting import Setting
from livlab.model.tissue.stack import Interaction


class PowerLawScatterer(ReducedScatterer):
    """Reduced scattering µs' = a (λ/λ0)^−b, or a (f_Ray (λ/λ0)⁻⁴ + (1−f_Ray)(λ/λ0)^−b_Mie) (Jacques 2013, eq. 1, 2)."""

    kind: Literal["power_law_scatterer"]
    a_per_cm: Amount = Field(description="µs' at the reference wavelength in 1/cm.")
    reference_nm: Length = Field(500.0, description="Reference wavelength λ0 in nm.")
    b: float | None = Field(None, description="Exponent of the first form.")
    f_ray: Share | None = Field(None, description="Rayleigh share of the second form.")
    b_mie: float | None = Field(None, description="Mie exponent of the second form.")

    units: ClassVar[dict[str, str]] = {
        "a_per_cm": "1/cm",
        "reference_nm": "nm",
        "b": "1",
        "f_ray": "1",
        "b_mie": "1",
        "anisotropy": "1",
    }

    @model_validator(mode="after")
    def _one_form(self) -> PowerLawScatterer:
        first, second = self.b is not None, self.f_ray is not None and self.b_mie is not None
        if first == second or (first and (self.f_ray is not None or self.b_mie is not None)):
            raise InputError.of(
                "b, f_ray, b_mie", (self.b, self.f_ray, self.b_mie), "needs b, or f_ray with b_mie", "Give one form."
            )
        return self

    def dataset_names(self) -> tuple[str, ...]:
        """None."""
        return ()

    def interaction(self, name: str, setting: Setting) -> Interaction:
        """µs'/(1 − g) by the form that is given."""
        wavelength = setting.wavelength_nm
        if self.b is not None:
            shape = chromophores.power_law(wavelength, 1.0, self.b, self.reference_nm)
        else:
            shape = rayleigh_mie(wavelength, self.f_ray or 0.0, self.b_mie or 0.0, self.reference_nm)
        return self.scattering(name, self.a_per_cm * shape, setting)

    def movable_scattering(self) -> MovableScattering:
        """The first form as the power law that it is; the second tilts, but a bench cannot write it down."""
        if self.b is None:
            return MovableScattering(tilts=True)
        at_500 = self.a_per_cm * (500.0 / self.reference_nm) ** -self.b
        return MovableScattering(
            tilts=True, formula="power", data={"a_per_cm": at_500, "b": self.b, "anisotropy": self.anisotropy}
        )

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Two forms of the dermis as Jacques prints them, by hand at one octave."""
        return (
            ReferenceValue(
                source="Jacques 2013, eq. 1 at 1000 nm with a = 45.3 1/cm, b = 1.292",
                element={"a_per_cm": 45.3, "b": 1.292, "anisotropy": 0.8},
                wavelength_nm=1000.0,
                rate=4.53 * 2.0**-1.292 / 0.2,
                albedo=1.0,
                anisotropy=0.8,
            ),
            ReferenceValue(
                source="Jacques 2013, eq. 2 at 1000 nm with a' = 43.6 1/cm, f_Ray = 0.41, b_Mie = 0.562",
                element={"a_per_cm": 43.6, "f_ray": 0.41, "b_mie": 0.562, "anisotropy": 0.8},
                wavelength_nm=1000.0,
                rate=4.36 * (0.41 / 16.0 + 0.59 * 2.0**-0.562) / 0.2,
                albedo=1.0,
                anisotropy=0.8,
            ),
        )
