"""Scattering by fibres, collagen and elastin: Nunes 2019, eq. 6.3–6.10, and what the readings make of them."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np

from livlab.model.tissue.elements import Fibre
from livlab.model.tissue.particles.cylinder import cylinder_mean
from livlab.model.tissue.particles.cylinder_lazy import lazy_cylinders
from livlab.model.tissue.particles.rayleigh import SIZE_LIMIT, rayleigh_efficiency
from livlab.model.tissue.particles.sphere import mie, mie_phase, size_parameter
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import Rayleigh
from livlab.model.tissue.setting import Setting, scatterer
from livlab.model.tissue.spectra import refractive_index
from livlab.model.tissue.stack import Interaction
from livlab.units import FloatArray, per_cm_to_per_mm, um_to_mm

Law = Literal["rayleigh", "sphere", "cylinder"]

UNPHYSICAL_EFFICIENCY = 6.0
"""A scattering efficiency above this is no sphere's of a tissue-like index: the report warns."""


def fibre(name: str, element: Fibre, setting: Setting) -> Interaction:
    """Fibres as the walk meets them (Nunes 2019, eq. 6.3–6.10; Bohren & Huffman 1983, ch. 8 for cylinders).

    By the reading: σ_s = Q f_v as a number in 1/cm; 4 Q f_v/(π d) for cylinders in all directions alike, Q being the
    cross section per length over the diameter; 3 Q f_v/(2 d) for spheres. All scattering, no absorption.

    Raises
    ------
    RangeError
        A wavelength outside the range of the fibre's index.
    """
    reading, medium = setting.reading, setting.n_medium
    wavelength = setting.wavelength_nm
    if element.volume_fraction == 0.0:
        return scatterer(name, np.zeros_like(wavelength), tuple, setting)
    printed = element.law == "rayleigh"
    n = refractive_index(element.index, wavelength, setting.note)
    m = n if printed and reading.elastin_index == "absolute" else n / medium
    x = size_parameter(um_to_mm(0.5 * element.diameter_um), wavelength, medium)
    if printed and reading.small_fibre_law == "rayleigh":
        law = "rayleigh"
    else:
        law = "cylinder" if reading.fibre_density == "cylinder" else "sphere"
    q = _efficiency(law, m.tobytes(), x.tobytes())
    if reading.mie_wavenumber == "vacuum" and law != "rayleigh":
        # Q is over k² r² for a sphere (eq. 6.5) and over k r for a cylinder, k one index too small each time.
        q = q * medium ** (2 if law == "sphere" else 1)
    _warn_about_fibre(name, law, q, x, setting)
    if reading.fibre_density == "areal":
        rate = per_cm_to_per_mm(q * element.volume_fraction)
    else:
        shape = 4.0 / math.pi if reading.fibre_density == "cylinder" else 1.5
        rate = shape * q * element.volume_fraction / um_to_mm(element.diameter_um)
    return scatterer(name, rate, lambda: _phases(law, m.tobytes(), x.tobytes()), setting)


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


def _warn_about_fibre(name: str, law: str, q: FloatArray, x: FloatArray, setting: Setting) -> None:
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
