"""From an element to its interaction: rate, albedo and phase functions at each wavelength."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from livlab import datasets
from livlab.errors import InputError
from livlab.model.tissue import chromophores
from livlab.model.tissue.elements import (
    Blood,
    Cell,
    Element,
    Fibre,
    LawAbsorber,
    Mixture,
    Pigment,
    PowerLawScatterer,
    PublishedScatterer,
    Solute,
)
from livlab.model.tissue.fibres import fibre
from livlab.model.tissue.particles import spheroid
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.setting import Setting, absorber, scatterer
from livlab.model.tissue.stack import Interaction
from livlab.units import FloatArray, per_cm_to_per_mm, um_to_mm


def interaction(name: str, element: Element, setting: Setting) -> Interaction:
    """An element as the walk meets it, under the setting's reading."""
    return _KINDS[type(element)](name, element, setting)


def _blood(name: str, element: Blood, setting: Setting) -> Interaction:
    table = datasets.load(element.dataset)
    hbo2, hb = (
        table.interpolate(column, setting.wavelength_nm, unit="1/(cm M)")
        for column in (element.hbo2_column, element.hb_column)
    )
    whole = chromophores.whole_blood(element.oxygenation, hbo2, hb, element.haemoglobin_g_per_l)
    return absorber(name, chromophores.blood(element.fraction, whole, um_to_mm(element.vessel_radius_um)))


def _mixture(name: str, element: Mixture, setting: Setting) -> Interaction:
    shares = element.shares()
    spectra = [part.spectrum.per_mm(setting.wavelength_nm, setting.note) for part in element.parts.values()]
    return absorber(name, chromophores.mixture(element.fraction, list(shares.values()), spectra))


def _pigment(name: str, element: Pigment, setting: Setting) -> Interaction:
    return absorber(name, element.fraction * element.spectrum.per_mm(setting.wavelength_nm, setting.note))


def _solute(name: str, element: Solute, setting: Setting) -> Interaction:
    extinction = element.spectrum.per_mm_per_mol_per_l(setting.wavelength_nm, setting.note)
    return absorber(name, chromophores.solute(element.concentration_umol_per_l, extinction))


def _law_absorber(name: str, element: LawAbsorber, setting: Setting) -> Interaction:
    if element.exponent is not None:
        law = chromophores.power_law(
            setting.wavelength_nm, element.scale_per_cm, element.exponent, element.reference_nm
        )
    else:
        decay = float(element.decay_nm or math.nan)
        law = chromophores.exponential_law(setting.wavelength_nm, element.scale_per_cm, decay, element.reference_nm)
    return absorber(name, per_cm_to_per_mm(element.fraction * (law + element.offset_per_cm)))


def _cell(name: str, element: Cell, setting: Setting) -> Interaction:
    reading = setting.reading
    one = np.ones_like(setting.wavelength_nm)
    sigma = cell_attenuation(element, reading) * one
    rate = spheroid.penalised_rate(sigma) if reading.hepatocyte_rate == "log10" else sigma
    more: dict[str, Any] = {"albedo": element.albedo * one}
    if reading.hepatocyte_absorption == "free_path":
        more = {"absorb_below_mm": um_to_mm(0.5 * (element.a_um + element.b_um))}
    return scatterer(name, rate, lambda: (HenyeyGreenstein(element.anisotropy),) * len(one), setting, **more)


def cell_attenuation(element: Cell, reading: Reading) -> float:
    """σ_t of cells in 1/mm (Nunes 2019, eq. 6.16), from their diameters as printed or from their semi-axes."""
    shrink = 1.0 if reading.hepatocyte_axes == "diameters" else 0.5
    return spheroid.attenuation(um_to_mm(shrink * element.a_um), um_to_mm(shrink * element.b_um), element.fraction)


def _power_law_scatterer(name: str, element: PowerLawScatterer, setting: Setting) -> Interaction:
    if element.b is not None:
        shape = chromophores.power_law(setting.wavelength_nm, 1.0, element.b, element.reference_nm)
    else:
        shape = _rayleigh_mie(setting.wavelength_nm, element.f_ray or 0.0, element.b_mie or 0.0, element.reference_nm)
    return _reduced(name, element.a_per_cm * shape, element.anisotropy, setting)


def _published_scatterer(name: str, element: PublishedScatterer, setting: Setting) -> Interaction:
    table = datasets.load(element.dataset)
    references = table.columns["reference"]
    if element.reference not in references:
        raise InputError.of(
            f"{name}.reference", element.reference, f"is no row of {element.dataset}", f"Rows: {', '.join(references)}."
        )
    row = list(references).index(element.reference)

    def number(column: str) -> float:
        value = float(table.column(column)[row])
        if not math.isfinite(value):
            raise InputError.of(
                f"{name}.form", element.form, f"{element.reference} has no {column}", "Use the other form."
            )
        return value

    if element.form == "power":
        reduced = chromophores.power_law(setting.wavelength_nm, number("a_musp500_per_cm"), number("b"), 500.0)
    else:
        shape = _rayleigh_mie(setting.wavelength_nm, number("f_Ray"), number("b_Mie"), 500.0)
        reduced = number("a_prime_musp500_per_cm") * shape
    setting.note(f"{name}: reduced scattering of {element.reference}, assumed anisotropy {element.anisotropy:g}.")
    return _reduced(name, reduced, element.anisotropy, setting)


def _rayleigh_mie(wavelength_nm: FloatArray, f_ray: float, b_mie: float, reference_nm: float) -> FloatArray:
    """Jacques 2013, eq. 2, over its value at the reference wavelength."""
    ray = chromophores.power_law(wavelength_nm, f_ray, 4.0, reference_nm)
    return ray + chromophores.power_law(wavelength_nm, 1.0 - f_ray, b_mie, reference_nm)


def _reduced(name: str, reduced_per_cm: FloatArray, g: float, setting: Setting) -> Interaction:
    # A uniform direction has g = 0, so µs = µs' there: the reduced coefficient is what was published.
    g = 0.0 if setting.reading.scattering_phase == "isotropic" else g
    rate = per_cm_to_per_mm(reduced_per_cm) / (1.0 - g)
    return scatterer(name, rate, lambda: (HenyeyGreenstein(g),) * len(rate), setting)


_KINDS: Mapping[type[Any], Callable[[str, Any, Setting], Interaction]] = {
    Blood: _blood,
    Cell: _cell,
    Fibre: fibre,
    LawAbsorber: _law_absorber,
    Mixture: _mixture,
    Pigment: _pigment,
    PowerLawScatterer: _power_law_scatterer,
    PublishedScatterer: _published_scatterer,
    Solute: _solute,
}
