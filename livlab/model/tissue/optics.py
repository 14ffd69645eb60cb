"""From a tissue and a reading to the optical stack that every solver reads: Nunes 2019, eq. 6.1–6.19."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from livlab import datasets
from livlab.errors import InputError
from livlab.model.tissue import chromophores, spheroid
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
)
from livlab.model.tissue.layers import FlatLayer
from livlab.model.tissue.phase import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.spectra import refractive_index
from livlab.model.tissue.stack import Interaction, OpticalStack, Phase, PlaneLayer
from livlab.model.tissue.tissue import Tissue
from livlab.units import FloatArray, per_cm_to_per_mm, um_to_mm

if TYPE_CHECKING:
    import xarray as xr

UNPHYSICAL_EFFICIENCY = 6.0
"""A scattering efficiency above this is no sphere's of a tissue-like index: the report warns."""

DENSE = 0.1
"""Fraction of fibres above which scattering by each alone (no packing correction) is worth a warning."""


@dataclass
class _Setting:
    """What an element needs to know beside itself."""

    wavelength_nm: FloatArray
    n_medium: FloatArray
    reading: Reading
    notes: dict[str, None] = field(default_factory=dict)

    def note(self, text: str) -> None:
        self.notes[text] = None


def optical_stack(tissue: Tissue, reading: Reading, wavelength_nm: Any) -> OpticalStack:
    """The optical stack of a tissue under a reading.

    Parameters
    ----------
    tissue
        The tissue; the reading's choices are applied to it.
    reading
        Which reading of the thesis.
    wavelength_nm
        (W,) wavelengths in nm, in any order.

    Returns
    -------
    Stack with one `Interaction` an element of each layer (sublayers written out), rates in 1/mm. Its `notes` hold
    what a report must say.

    Raises
    ------
    RangeError
        A wavelength outside the range of a spectrum or index of the tissue.
    InputError
        Wavelengths that are not a one-dimensional array of positive numbers, or a published fit that is not there.

    Examples
    --------
    >>> from livlab.model.tissue.presets import load_preset
    >>> from livlab.model.tissue.readings import READINGS
    >>> stack = optical_stack(load_preset("liver"), READINGS["thesis"], [500.0, 600.0])
    >>> [layer.name for layer in stack.layers]
    ['capsule 1', 'capsule 2', 'capsule 3', 'capsule 4', 'parenchyma']
    """
    wavelength = _wavelengths(wavelength_nm)
    plain = tissue.under(reading)
    notes: dict[str, None] = {}
    layers = []
    for flat in plain.flat():
        setting = _Setting(wavelength, np.empty(0), reading, notes)
        setting.n_medium = refractive_index(flat.index, wavelength, setting.note)
        parts = tuple(_interaction(name, element, setting) for name, element in flat.elements.items())
        layers.append(PlaneLayer(flat.name, flat.thickness_mm, setting.n_medium, parts))
        _warn_if_dense(flat, setting)
    edge = _Setting(wavelength, np.empty(0), reading, notes)
    _warn_about(reading, edge)
    return OpticalStack(
        wavelength,
        tuple(layers),
        refractive_index(plain.n_above, wavelength, edge.note),
        refractive_index(plain.n_below, wavelength, edge.note),
        f"{plain.name}, {plain.state}, {reading.name}" if plain.state else f"{plain.name}, {reading.name}",
        tuple(notes),
    )


def coefficients(tissue: Tissue, reading: Reading, wavelength_nm: Any) -> xr.Dataset:
    """Absorption, scattering and anisotropy of each element of each layer.

    Returns
    -------
    Dataset with dims layer, element, wavelength: rate, absorption = rate (1 − albedo), scattering = rate · albedo,
    in 1/mm, and anisotropy g of what scatters. NaN where a layer lacks the element (anisotropy: where it does not
    scatter). The factor of Algorithm 2 and absorption by a short free path are not in it: see the attributes
    redirect and absorb_below_mm.

    Raises
    ------
    RangeError, InputError
        As `optical_stack`.

    Examples
    --------
    >>> from livlab.model.tissue.presets import load_preset
    >>> from livlab.model.tissue.readings import READINGS
    >>> found = coefficients(load_preset("liver"), READINGS["consistent"], [500.0])
    >>> float(found.scattering.sel(layer="parenchyma", element="hepatocyte").item()).__round__(2)
    53.85
    """
    return stack_coefficients(optical_stack(tissue, reading, wavelength_nm))


def stack_coefficients(stack: OpticalStack) -> xr.Dataset:
    """`coefficients` of a stack that is already made."""
    import xarray as xr

    names = list(dict.fromkeys(i.name for layer in stack.layers for i in layer.interactions))
    shape = (len(stack.layers), len(names), len(stack.wavelength_nm))
    rate, absorption, scattering, anisotropy = (np.full(shape, np.nan) for _ in range(4))
    factors: dict[str, str] = {}
    lengths: dict[str, float] = {}
    for k, layer in enumerate(stack.layers):
        for i in layer.interactions:
            e = names.index(i.name)
            rate[k, e] = i.rate
            absorption[k, e] = i.rate * (1.0 - i.albedo)
            scattering[k, e] = i.rate * i.albedo
            known = {id(p): p for p in i.phases}
            g = {key: p.anisotropy for key, p in known.items()}
            anisotropy[k, e] = np.where(scattering[k, e] > 0, [g[id(p)] for p in i.phases], np.nan)
            factors[i.name], lengths[i.name] = i.redirect, i.absorb_below_mm
    dims = ("layer", "element", "wavelength")
    per_mm = {"units": "1/mm"}
    return xr.Dataset(
        {
            "rate": (dims, rate, {**per_mm, "long_name": "rate of the walk's exponential draws"}),
            "absorption": (dims, absorption, {**per_mm, "long_name": "absorption coefficient"}),
            "scattering": (dims, scattering, {**per_mm, "long_name": "scattering coefficient"}),
            "anisotropy": (dims, anisotropy, {"units": "1", "long_name": "mean cosine of the scattering angle"}),
        },
        coords={
            "layer": [x.name for x in stack.layers],
            "element": (("element",), names),
            "wavelength": ("wavelength", stack.wavelength_nm, {"units": "nm"}),
            "thickness": ("layer", [x.thickness_mm for x in stack.layers], {"units": "mm"}),
            "redirect": ("element", [factors[n] for n in names]),
            "absorb_below": ("element", [lengths[n] for n in names], {"units": "mm"}),
        },
        attrs={"stack": stack.name, "notes": "\n".join(stack.notes)},
    )


def _wavelengths(value: Any) -> FloatArray:
    found = np.atleast_1d(np.asarray(value, dtype=float))
    if found.ndim != 1 or not found.size or not (np.isfinite(found) & (found > 0)).all():
        raise InputError.of("wavelength_nm", value, "must be positive numbers in one dimension", "Give them in nm.")
    return found


def _interaction(name: str, element: Element, setting: _Setting) -> Interaction:
    return _KINDS[type(element)](name, element, setting)


def _absorber(name: str, rate: FloatArray) -> Interaction:
    return Interaction(name, rate, np.zeros_like(rate), (Isotropic(),) * len(rate))


def _scatterer(
    name: str, rate: FloatArray, phases: Callable[[], tuple[Phase, ...]], setting: _Setting, **more: Any
) -> Interaction:
    """A scatterer of albedo 1 unless `more` says otherwise; phases are only worked out where they count."""
    uniform = setting.reading.scattering_phase == "isotropic" or not rate.any()
    chosen = (Isotropic(),) * len(rate) if uniform else phases()
    return Interaction(
        name, rate, more.pop("albedo", np.ones_like(rate)), chosen, setting.reading.redirect_factor, **more
    )


def _blood(name: str, element: Blood, setting: _Setting) -> Interaction:
    table = datasets.load(element.dataset)
    hbo2, hb = (
        table.interpolate(column, setting.wavelength_nm, unit="1/(cm M)")
        for column in (element.hbo2_column, element.hb_column)
    )
    whole = chromophores.whole_blood(element.oxygenation, hbo2, hb, element.haemoglobin_g_per_l)
    return _absorber(name, chromophores.blood(element.fraction, whole, um_to_mm(element.vessel_radius_um)))


def _mixture(name: str, element: Mixture, setting: _Setting) -> Interaction:
    shares = element.shares()
    spectra = [part.spectrum.per_mm(setting.wavelength_nm, setting.note) for part in element.parts.values()]
    return _absorber(name, chromophores.mixture(element.fraction, list(shares.values()), spectra))


def _pigment(name: str, element: Pigment, setting: _Setting) -> Interaction:
    return _absorber(name, element.fraction * element.spectrum.per_mm(setting.wavelength_nm, setting.note))


def _law_absorber(name: str, element: LawAbsorber, setting: _Setting) -> Interaction:
    if element.exponent is not None:
        law = chromophores.power_law(
            setting.wavelength_nm, element.scale_per_cm, element.exponent, element.reference_nm
        )
    else:
        decay = float(element.decay_nm or math.nan)
        law = chromophores.exponential_law(setting.wavelength_nm, element.scale_per_cm, decay, element.reference_nm)
    return _absorber(name, per_cm_to_per_mm(element.fraction * (law + element.offset_per_cm)))


def _cell(name: str, element: Cell, setting: _Setting) -> Interaction:
    reading = setting.reading
    one = np.ones_like(setting.wavelength_nm)
    sigma = cell_attenuation(element, reading) * one
    rate = spheroid.penalised_rate(sigma) if reading.hepatocyte_rate == "log10" else sigma
    more: dict[str, Any] = {"albedo": element.albedo * one}
    if reading.hepatocyte_absorption == "free_path":
        more = {"absorb_below_mm": um_to_mm(0.5 * (element.a_um + element.b_um))}
    return _scatterer(name, rate, lambda: (HenyeyGreenstein(element.anisotropy),) * len(one), setting, **more)


def cell_attenuation(element: Cell, reading: Reading) -> float:
    """σ_t of cells in 1/mm (Nunes 2019, eq. 6.16), from their diameters as printed or from their semi-axes."""
    shrink = 1.0 if reading.hepatocyte_axes == "diameters" else 0.5
    return spheroid.attenuation(um_to_mm(shrink * element.a_um), um_to_mm(shrink * element.b_um), element.fraction)


def _power_law_scatterer(name: str, element: PowerLawScatterer, setting: _Setting) -> Interaction:
    if element.b is not None:
        shape = chromophores.power_law(setting.wavelength_nm, 1.0, element.b, element.reference_nm)
    else:
        shape = _rayleigh_mie(setting.wavelength_nm, element.f_ray or 0.0, element.b_mie or 0.0, element.reference_nm)
    return _reduced(name, element.a_per_cm * shape, element.anisotropy, setting)


def _published_scatterer(name: str, element: PublishedScatterer, setting: _Setting) -> Interaction:
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


def _reduced(name: str, reduced_per_cm: FloatArray, g: float, setting: _Setting) -> Interaction:
    # A uniform direction has g = 0, so µs = µs' there: the reduced coefficient is what was published.
    g = 0.0 if setting.reading.scattering_phase == "isotropic" else g
    rate = per_cm_to_per_mm(reduced_per_cm) / (1.0 - g)
    return _scatterer(name, rate, lambda: (HenyeyGreenstein(g),) * len(rate), setting)


def _fibre(name: str, element: Fibre, setting: _Setting) -> Interaction:
    reading, medium = setting.reading, setting.n_medium
    wavelength = setting.wavelength_nm
    if element.volume_fraction == 0.0:
        return _scatterer(name, np.zeros_like(wavelength), tuple, setting)
    printed = element.law == "rayleigh"
    n = refractive_index(element.index, wavelength, setting.note)
    m = n if printed and reading.elastin_index == "absolute" else n / medium
    from livlab.model.tissue.mie import size_parameter

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
    return _scatterer(name, rate, lambda: _phases(law, m.tobytes(), x.tobytes()), setting)


@lru_cache(maxsize=64)
def _efficiency(law: str, m: bytes, x: bytes) -> FloatArray:
    index, size = np.frombuffer(m), np.frombuffer(x)
    if law == "rayleigh":
        from livlab.model.tissue.rayleigh import rayleigh_efficiency

        q = np.asarray(rayleigh_efficiency(index, size), dtype=float)
    elif law == "sphere":
        from livlab.model.tissue.mie import mie

        q = np.asarray(mie(index, size).q_sca, dtype=float)
    else:
        from livlab.model.tissue.cylinder import cylinder_mean

        q = np.asarray(cylinder_mean(index, size).q_sca, dtype=float)
    q.setflags(write=False)
    return q


@lru_cache(maxsize=64)
def _phases(law: str, m: bytes, x: bytes) -> tuple[Phase, ...]:
    index, size = np.frombuffer(m), np.frombuffer(x)
    if law == "rayleigh":
        return (Rayleigh(),) * len(index)
    if law == "sphere":
        from livlab.model.tissue.mie import mie_phase

        return tuple(mie_phase(complex(a), float(b)) for a, b in zip(index, size, strict=True))
    from livlab.model.tissue.cylinder import cylinder_phase

    return tuple(cylinder_phase(complex(a), float(b)) for a, b in zip(index, size, strict=True))


def _warn_about_fibre(name: str, law: str, q: FloatArray, x: FloatArray, setting: _Setting) -> None:
    top = float(q.max())
    if top > UNPHYSICAL_EFFICIENCY:
        setting.note(
            f"{name}: scattering efficiency up to {top:.3g}, beyond what a fibre can have "
            f"(Rayleigh's law as printed, eq. 6.8, at size parameter {float(x.max()):.2g})."
            if law == "rayleigh"
            else f"{name}: scattering efficiency up to {top:.3g}, beyond what a fibre can have."
        )
    elif law == "rayleigh" and float(x.max()) > 0.2 * math.pi:
        setting.note(f"{name}: Rayleigh's law at size parameter up to {float(x.max()):.2g}; it asks for r < λ/10.")


def _warn_if_dense(layer: FlatLayer, setting: _Setting) -> None:
    share = sum(e.volume_fraction for e in layer.elements.values() if isinstance(e, Fibre))
    if share > DENSE and setting.reading.fibre_density != "areal":
        setting.note(
            f"{layer.name}: fibres fill {share:.0%}; each scatters as if alone (no packing correction), "
            "which overrates them when dense."
        )


def _warn_about(reading: Reading, setting: _Setting) -> None:
    if reading.fibre_density == "areal":
        setting.note("Fibres: Q f_v has no unit; the number is taken as 1/cm (eq. 6.3, 6.7).")
    if reading.mie_wavenumber == "vacuum":
        setting.note("Fibres: Q with the vacuum's wavenumber (eq. 6.6) is no efficiency.")
    if reading.redirect_factor == "cos":
        setting.note("The factor cos θ has mean zero: scattered light averages to nothing and can be negative.")
    if reading.hepatocyte_rate == "log10":
        setting.note("Hepatocytes: the penalised free path (eq. 6.19) makes more cells scatter less.")


_KINDS: Mapping[type[Any], Callable[[str, Any, _Setting], Interaction]] = {
    Blood: _blood,
    Cell: _cell,
    Fibre: _fibre,
    LawAbsorber: _law_absorber,
    Mixture: _mixture,
    Pigment: _pigment,
    PowerLawScatterer: _power_law_scatterer,
    PublishedScatterer: _published_scatterer,
}
