"""Scattering by fibres, collagen and elastin: Nunes 2019, eq. 6.3–6.10, and what the readings make of them."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from livlab.model.tissue.elements.base import Budget, Length, ReferenceValue, Remarks, Scatterer, Share
from livlab.model.tissue.particles.cylinder import cylinder_mean
from livlab.model.tissue.particles.cylinder_lazy import lazy_cylinders
from livlab.model.tissue.particles.rayleigh import SIZE_LIMIT, rayleigh_efficiency
from livlab.model.tissue.particles.sphere import mie, mie_phase, size_parameter
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import Rayleigh
from livlab.model.tissue.readings import Reading, Subject
from livlab.model.tissue.setting import Setting, scatterer
from livlab.model.tissue.spectra import Index, names_of, refractive_index
from livlab.model.tissue.stack import Interaction
from livlab.units import FloatArray, per_cm_to_per_mm, um_to_mm

Law = Literal["rayleigh", "sphere", "cylinder"]

UNPHYSICAL_EFFICIENCY = 6.0
"""A scattering efficiency above this is no sphere's of a tissue-like index: the report warns."""


class Fibre(Scatterer):
    """Fibres: collagen, elastin. Scatter only."""

    kind: Literal["fibre"]
    volume_fraction: Share = Field(description="Volume fraction.")
    diameter_um: Length = Field(description="Mean diameter in µm.")
    index: Index = Field(description="Refractive index, absolute.")
    law: Literal["mie", "rayleigh"] = Field("mie", description="Law that the thesis gives it.")

    budget: ClassVar[Budget] = "structure"
    units: ClassVar[dict[str, str]] = {"volume_fraction": "1", "diameter_um": "µm", "index": "1"}

    @property
    def share(self) -> float:
        """Volume fraction."""
        return self.volume_fraction

    def dataset_names(self) -> tuple[str, ...]:
        """The index's dataset, if any."""
        return names_of(self.index)

    def interaction(self, name: str, setting: Setting) -> Interaction:
        """Fibres as the walk meets them (Nunes 2019, eq. 6.3–6.10; Bohren & Huffman 1983, ch. 8 for cylinders).

        By the reading: σ_s = Q f_v as a number in 1/cm; 4 Q f_v/(π d) for cylinders in all directions alike, Q being
        the cross section per length over the diameter; 3 Q f_v/(2 d) for spheres. All scattering, no absorption.

        Raises
        ------
        RangeError
            A wavelength outside the range of the fibre's index.
        """
        reading, medium = setting.reading, setting.n_medium
        wavelength = setting.wavelength_nm
        if self.volume_fraction == 0.0:
            return scatterer(name, np.zeros_like(wavelength), tuple, setting)
        n = refractive_index(self.index, wavelength, setting.note)
        m = n if self.law == "rayleigh" and reading.elastin_index == "absolute" else n / medium
        x = size_parameter(um_to_mm(0.5 * self.diameter_um), wavelength, medium)
        law = self._law(reading)
        q = _efficiency(law, m.tobytes(), x.tobytes())
        if reading.mie_wavenumber == "vacuum" and law != "rayleigh":
            # Q is over k² r² for a sphere (eq. 6.5) and over k r for a cylinder, k one index too small each time.
            q = q * medium ** (2 if law == "sphere" else 1)
        _warn_about(name, law, q, x, setting)
        if reading.fibre_density == "areal":
            rate = per_cm_to_per_mm(q * self.volume_fraction)
        else:
            shape = 4.0 / math.pi if reading.fibre_density == "cylinder" else 1.5
            rate = shape * q * self.volume_fraction / um_to_mm(self.diameter_um)
        return scatterer(name, rate, lambda: _phases(law, m.tobytes(), x.tobytes()), setting)

    def _law(self, reading: Reading) -> Law:
        if self.law == "rayleigh" and reading.small_fibre_law == "rayleigh":
            return "rayleigh"
        return "cylinder" if reading.fibre_density == "cylinder" else "sphere"

    def subjects(self) -> tuple[Subject, ...]:
        """Fibres."""
        return ("fibres",)

    def remarks(self, reading: Reading) -> Remarks:
        """That the printed σ_s has no unit, and the printed Q is none; else that fibres scatter as if alone."""
        areal = reading.fibre_density == "areal"
        told = ["Fibres: Q f_v has no unit; the number is taken as 1/cm (eq. 6.3, 6.7)."] if areal else []
        if reading.mie_wavenumber == "vacuum":
            told.append("Fibres: Q with the vacuum's wavenumber (eq. 6.6) is no efficiency.")
        return Remarks(coefficients=tuple(told), alone="" if areal else "fibres")

    def movable_scattering(self) -> None:
        """None: what a bench does to the rest of the layer, it does to fibres."""

    @classmethod
    def reference_values(cls) -> tuple[ReferenceValue, ...]:
        """Bohren & Huffman's sphere, Rayleigh's law by hand, and thin cylinders that hardly scatter."""
        thin, contrast = 1e-3, 1.00001**2 - 1.0
        q_thin = 11.0 / 15.0 * math.pi**2 / 8.0 * thin**3 * contrast**2
        diameter_um = thin * 0.5 / math.pi
        x = math.pi * 500.0 * 1.35 / 500.0
        rayleigh = 8.0 / 3.0 * x**4 * ((1.5**2 - 1.0) / (1.5**2 + 2.0)) ** 2
        return (
            ReferenceValue(
                source="Bohren & Huffman 1983, appendix A: x = 5.213, m = 1.55, Q = 3.10543; 3 Q f/(2 d)",
                element={"volume_fraction": 0.1, "diameter_um": 1.05, "index": 1.55},
                wavelength_nm=632.8,
                reading=("consistent", {"fibre_density": "sphere"}),
                rate=1.5 * 3.10543 * 0.1 / 1.05e-3,
                albedo=1.0,
                anisotropy=0.63314,
                relative=1e-5,
            ),
            ReferenceValue(
                source="Nunes 2019, eq. 6.8 as printed, of elastin: Q = 8/3 x⁴ |(m² − 1)/(m² + 2)|², Q f in 1/cm",
                element={"volume_fraction": 0.051, "diameter_um": 0.5, "index": 1.5, "law": "rayleigh"},
                n_medium=1.35,
                reading=("thesis", {}),
                rate=0.1 * rayleigh * 0.051,
                albedo=1.0,
                anisotropy=0.0,
            ),
            # A line of dipoles at ζ scatters π² x³ (m² − 1)²/8 times the mean of 1 − (e·s)² over its cone: 1 − sin²ζ/2
            # and 1 − 3/2 sin²ζ cos²ζ, by polarisation. Over all axes their mean is 11/15, weighed by cos Θ 31/105.
            ReferenceValue(
                source="thin cylinders in all directions alike: Q = 11/15 π² x³ (m² − 1)²/8, 4 Q f/(π d)",
                element={"volume_fraction": 0.1, "diameter_um": diameter_um, "index": 1.00001},
                rate=4.0 * q_thin * 0.1 / (math.pi * 1e-3 * diameter_um),
                albedo=1.0,
                anisotropy=31.0 / 77.0,
                relative=5e-5,
            ),
        )


@lru_cache(maxsize=64)
def _efficiency(law: str, m: bytes, x: bytes) -> FloatArray:
    index, size = np.frombuffer(m), np.frombuffer(x)
    if law == "rayleigh":
        q = np.asarray(rayleigh_efficiency(index, size), dtype=float)
    elif law == "sphere":
        q = np.asarray(mie(index, size).q_sca, dtype=float)
    else:
        q = np.asarray(cylinder_mean(index, size).q_sca, dtype=float)
    q.setflags(write=False)
    return q


@lru_cache(maxsize=8)
def _phases(law: str, m: bytes, x: bytes) -> tuple[Phase, ...]:
    index, size = np.frombuffer(m), np.frombuffer(x)
    if law == "rayleigh":
        return (Rayleigh(),) * len(index)
    if law == "sphere":
        return tuple(mie_phase(complex(a), float(b)) for a, b in zip(index, size, strict=True))
    return lazy_cylinders(index, size)


def _warn_about(name: str, law: str, q: FloatArray, x: FloatArray, setting: Setting) -> None:
    top = float(q.max())
    if top > UNPHYSICAL_EFFICIENCY:
        setting.note(
            f"{name}: scattering efficiency up to {top:.3g}, beyond what a fibre can have "
            f"(Rayleigh's law as printed, eq. 6.8, at size parameter {float(x.max()):.2g})."
            if law == "rayleigh"
            else f"{name}: scattering efficiency up to {top:.3g}, beyond what a fibre can have."
        )
    elif law == "rayleigh" and float(x.max()) > SIZE_LIMIT:
        setting.note(f"{name}: Rayleigh's law at size parameter up to {float(x.max()):.2g}; it asks for r < λ/10.")
