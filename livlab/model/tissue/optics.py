"""From a tissue and a reading to the optical stack that every solver reads: Nunes 2019, eq. 6.1–6.19."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.layers import FlatLayer
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.setting import Setting
from livlab.model.tissue.spectra import refractive_index
from livlab.model.tissue.stack import OpticalStack, PlaneLayer
from livlab.model.tissue.tissue import Tissue
from livlab.units import FloatArray

if TYPE_CHECKING:
    import xarray as xr

DENSE = 0.1
"""Fraction of fibres, say, above which scattering by each alone (no packing correction) is worth a warning."""


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
        setting = Setting(wavelength, np.empty(0), reading, notes)
        setting.n_medium = refractive_index(flat.index, wavelength, setting.note)
        parts = tuple(element.interaction(name, setting) for name, element in flat.elements.items())
        layers.append(PlaneLayer(flat.name, flat.thickness_mm, setting.n_medium, parts))
        _warn_if_dense(flat, setting)
    edge = Setting(wavelength, np.empty(0), reading, notes)
    _warn_about(reading, plain, edge)
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


def _warn_if_dense(layer: FlatLayer, setting: Setting) -> None:
    shares: dict[str, float] = {}
    for element in layer.elements.values():
        what = element.remarks(setting.reading).alone
        if what:
            shares[what] = shares.get(what, 0) + element.share
    for what, share in shares.items():
        if share > DENSE:
            setting.note(
                f"{layer.name}: {what} fill {share:.0%}; each scatters as if alone (no packing correction), "
                "which overrates them when dense."
            )


def _warn_about(reading: Reading, tissue: Tissue, setting: Setting) -> None:
    """Notes of what a reading does to this tissue: what it has nothing of is not spoken of."""
    told = [e.remarks(reading) for layer in tissue.layers for e in layer.elements.values()]
    for text in (text for x in told for text in x.coefficients):
        setting.note(text)
    if reading.redirect_factor == "cos":
        setting.note("The factor cos θ has mean zero: scattered light averages to nothing and can be negative.")
    for text in (text for x in told for text in x.walk):
        setting.note(text)
