"""What scatterers that are given by µs' share: µs = µs'/(1 − g), and whom they stand in for."""

from __future__ import annotations

from pydantic import Field

from livlab.model.tissue import chromophores
from livlab.model.tissue.elements.base import Anisotropy, Remarks, Scatterer
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.readings import Reading, Subject
from livlab.model.tissue.setting import Setting, scatterer
from livlab.model.tissue.stack import Interaction
from livlab.units import FloatArray, per_cm_to_per_mm


class ReducedScatterer(Scatterer):
    """A scatterer given by its reduced scattering; its own g only turns µs' into µs."""

    anisotropy: Anisotropy = Field(description="g of the Henyey–Greenstein phase function; µs = µs'/(1 − g).")
    replaces: str = Field(
        "",
        description="Element it stands in for where the reading takes published scattering; always there if not said.",
    )

    @property
    def stands_in_for(self) -> str:
        """What it replaces."""
        return self.replaces

    def subjects(self) -> tuple[Subject, ...]:
        """Stand-ins, if it is one."""
        return ("stand-ins",) if self.replaces else ()

    def remarks(self, reading: Reading) -> Remarks:
        """Nothing, whatever the reading."""
        return Remarks()

    def limits(self, name: str, key: str) -> str:
        """What its anisotropy does."""
        if key != "anisotropy":
            return ""
        return f"In this model µs' of {name} is given and kept: its anisotropy only changes how it is made up."

    def scattering(self, name: str, reduced_per_cm: FloatArray, setting: Setting) -> Interaction:
        """The element from its µs' in 1/cm."""
        # A uniform direction has g = 0, so µs = µs' there: the reduced coefficient is what was published.
        g = 0.0 if setting.reading.scattering_phase == "isotropic" else self.anisotropy
        rate = per_cm_to_per_mm(reduced_per_cm) / (1.0 - g)
        return scatterer(name, rate, lambda: (HenyeyGreenstein(g),) * len(rate), setting)


def rayleigh_mie(wavelength_nm: FloatArray, f_ray: float, b_mie: float, reference_nm: float) -> FloatArray:
    """Jacques 2013, eq. 2, over its value at the reference wavelength."""
    ray = chromophores.power_law(wavelength_nm, f_ray, 4.0, reference_nm)
    return ray + chromophores.power_law(wavelength_nm, 1.0 - f_ray, b_mie, reference_nm)
