"""Reduced scattering by a published fit, a row of a dataset (Jacques 2013, Table 1)."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field

from livlab import datasets
from livlab.errors import InputError
from livlab.model.tissue import chromophores
from livlab.model.tissue.elements.base import MovableScattering, ReferenceValue
from livlab.model.tissue.elements.reduced import ReducedScatterer, rayleigh_mie
from livlab.model.tissue.setting import Setting
from livlab.model.tissue.stack import Interaction

REFERENCE_NM = 500.0
"""Wavelength at which the fits are given."""


class PublishedScatterer(ReducedScatterer):
    """Reduced scattering by a published fit: a row of a table in the form of `liver_reduced_scattering_jacques2013`."""

    kind: Literal["published_scatterer"]
    dataset: str = Field(description="Dataset of the fits.")
    reference: str = Field(description="Row, by its column `reference`.")
    form: Literal["power", "rayleigh_mie"] = Field("power", description="Which of the row's two forms.")

    units: ClassVar[dict[str, str]] = {"anisotropy": "1"}

    def dataset_names(self) -> tuple[str, ...]:
        """The fits' dataset."""
        return (self.dataset,)

    def interaction(self, name: str, setting: Setting) -> Interaction:
        """µs'/(1 − g) by the row's form.

        Raises
        ------
        InputError
            A row that is not there, or one without this form.
        """
        wavelength = setting.wavelength_nm
        if self.form == "power":
            a, b = self._numbers(name, "a_musp500_per_cm", "b")
            reduced = chromophores.power_law(wavelength, a, b, REFERENCE_NM)
        else:
            f_ray, b_mie, a = self._numbers(name, "f_Ray", "b_Mie", "a_prime_musp500_per_cm")
            reduced = a * rayleigh_mie(wavelength, f_ray, b_mie, REFERENCE_NM)
        setting.note(f"{name}: reduced scattering of {self.reference}, assumed anisotropy {self.anisotropy:g}.")
        return self.scattering(name, reduced, setting)

    def _numbers(self, name: str, *columns: str) -> tuple[float, ...]:
        """The row's numbers of a form."""
        table = datasets.load(self.dataset)
        references = list(table.columns["reference"])
        if self.reference not in references:
            raise InputError.of(
                f"{name}.reference", self.reference, f"is no row of {self.dataset}", f"Rows: {', '.join(references)}."
            )
        row = references.index(self.reference)
        found = {column: float(table.column(column)[row]) for column in columns}
        for column, value in found.items():
            if not math.isfinite(value):
                raise InputError.of(
                    f"{name}.form", self.form, f"{self.reference} has no {column}", "Use the other form."
                )
        return tuple(found.values())

    def movable_scattering(self) -> MovableScattering:
        """The power law as the one that it is; the other form tilts, but a bench cannot write it down."""
        if self.form != "power":
            return MovableScattering(tilts=True)
        a, b = self._numbers("scattering", "a_musp500_per_cm", "b")
        return MovableScattering(
            tilts=True, formula="power", data={"a_per_cm": a, "b": b, "anisotropy": self.anisotropy}
        )

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Two livers of Jacques 2013, Table 1, an octave above where they are printed."""
        table = {"dataset": "liver_reduced_scattering_jacques2013", "anisotropy": 0.9}
        return (
            ReferenceValue(
                source="Jacques 2013, Table 1: 9.2 (λ/500)^−1.05 in 1/cm (Alexandrakis 2005)",
                element=table | {"reference": "Alexandrakis et al 2005"},
                wavelength_nm=1000.0,
                rate=0.92 * 2.0**-1.05 / 0.1,
                albedo=1.0,
                anisotropy=0.9,
            ),
            ReferenceValue(
                source="Jacques 2013, Table 1: 11.5 (0.61 (λ/500)⁻⁴ + 0.39) in 1/cm (Parsa 1989)",
                element=table | {"reference": "Parsa et al 1989", "form": "rayleigh_mie"},
                wavelength_nm=1000.0,
                rate=1.15 * (0.61 / 16.0 + 0.39) / 0.1,
                albedo=1.0,
                anisotropy=0.9,
            ),
        )
