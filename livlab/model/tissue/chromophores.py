"""Absorption by chromophores: blood and its packaging, mixtures, solutes, analytic laws (Nunes 2019, 6.12–6.15)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from livlab.errors import InputError
from livlab.units import FloatArray, per_cm_to_per_mm

HAEMOGLOBIN_G_PER_MOL = 64500.0
"""Molar mass of haemoglobin as Prahl's compilation takes it."""

NAPIERIAN = 2.303
"""ln 10 as Prahl's compilation rounds it; whole blood at 150 g/L absorbs 0.0053558 ε in 1/cm."""


def packaging(radius_mm: float, sigma_per_mm: FloatArray) -> FloatArray:
    """Packaging factor C = (1 − e^(−2Rσ))/(2Rσ) of a pigment confined to vessels (Nunes 2019, eq. 6.13).

    Falls from 1 (Rσ → 0: the pigment is spread evenly) to 0 (Rσ → ∞: it hides in its own shadow).

    Parameters
    ----------
    radius_mm
        Mean vessel radius R ≥ 0 in mm.
    sigma_per_mm
        Absorption σ ≥ 0 inside the vessel in 1/mm, any shape.

    Returns
    -------
    C in [0, 1], of σ's shape.

    Raises
    ------
    InputError
        A negative or undefined radius or absorption.

    Examples
    --------
    >>> packaging(0.05, np.array([0.0, 10.0])).round(6)
    array([1.      , 0.632121])
    """
    _non_negative("vessel radius", radius_mm)
    _non_negative("absorption in the vessel", sigma_per_mm)
    sigma = np.asarray(sigma_per_mm, dtype=float)
    depth = np.where(sigma > 0, 2.0 * radius_mm * np.where(sigma > 0, sigma, 1.0), 0.0)  # 0, however large the vessel
    safe = np.where(depth > 0, depth, 1.0)
    return np.where(depth > 0, -np.expm1(-safe) / safe, 1.0)


def whole_blood(
    oxygenation: float, extinction_hbo2: FloatArray, extinction_hb: FloatArray, haemoglobin_g_per_l: float = 150.0
) -> FloatArray:
    """Absorption of whole blood in 1/mm: the bracket of Nunes 2019, eq. 6.12.

    S σ_HbO2 + (1 − S) σ_Hb, each σ = 2.303 ε x/64500 in 1/cm (Prahl).

    Parameters
    ----------
    oxygenation
        S_tO2, 0–1.
    extinction_hbo2, extinction_hb
        Molar extinction ε in 1/(cm M), one entry a wavelength.
    haemoglobin_g_per_l
        Concentration x in g/L.

    Raises
    ------
    InputError
        S outside 0–1, or a negative extinction or concentration.

    Examples
    --------
    >>> (whole_blood(1.0, np.array([1e4]), np.array([0.0])) * 10).round(3)
    array([53.558])
    """
    if not 0.0 <= oxygenation <= 1.0:
        raise InputError.of("oxygenation", oxygenation, "must be within [0, 1]", "Give a share of 1, not a percentage.")
    _non_negative("haemoglobin", haemoglobin_g_per_l)
    _non_negative("extinction of HbO2", extinction_hbo2)
    _non_negative("extinction of Hb", extinction_hb)
    molar = NAPIERIAN * haemoglobin_g_per_l / HAEMOGLOBIN_G_PER_MOL
    mixed = oxygenation * np.asarray(extinction_hbo2) + (1.0 - oxygenation) * np.asarray(extinction_hb)
    return per_cm_to_per_mm(molar * mixed)


def blood(fraction: float, whole_per_mm: FloatArray, vessel_radius_mm: float) -> FloatArray:
    """Absorption of perfused tissue by its blood in 1/mm: f σ C(R, σ) (Nunes 2019, eq. 6.12, 6.13).

    Parameters
    ----------
    fraction
        Volume fraction of blood, 0–1.
    whole_per_mm
        Absorption σ of whole blood in 1/mm.
    vessel_radius_mm
        Mean vessel radius R in mm; 0 leaves the packaging out.

    Raises
    ------
    InputError
        A fraction outside 0–1, a negative radius or absorption.
    """
    _share("blood fraction", fraction)
    return fraction * np.asarray(whole_per_mm) * packaging(vessel_radius_mm, whole_per_mm)


def mixture(fraction: float, shares: Sequence[float], absorptions: Sequence[FloatArray]) -> FloatArray:
    """Absorption of a mixture: f Σ s_i σ_i, in the unit of σ (Nunes 2019, eq. 6.14 for lipid and water).

    Parameters
    ----------
    fraction
        Volume fraction of the mixture, 0–1.
    shares
        Shares s_i of the mixture, each 0–1, their sum at most 1.
    absorptions
        σ_i, one array of equal shape a share.

    Raises
    ------
    InputError
        A fraction or share outside 0–1, or shares that sum above 1.

    Examples
    --------
    >>> mixture(0.5, [0.2, 0.8], [np.array([10.0]), np.array([1.0])])
    array([1.4])
    """
    _share("fraction", fraction)
    for s in shares:
        _share("share", s)
    if sum(shares) > 1.0 + 1e-9:
        raise InputError.of("shares", tuple(shares), "must sum to at most 1", "Lower a share.")
    total = np.zeros_like(np.asarray(absorptions[0], dtype=float))
    for s, sigma in zip(shares, absorptions, strict=True):
        _non_negative("absorption", sigma)
        total = total + s * np.asarray(sigma)
    return fraction * total


def solute(concentration_umol_per_l: float, extinction_per_mm_per_mol_per_l: FloatArray) -> FloatArray:
    """Absorption of a dissolved chromophore in 1/mm: ln(10) ε c (Beer and Lambert, ε to the base 10).

    Parameters
    ----------
    concentration_umol_per_l
        Concentration c in µmol/L.
    extinction_per_mm_per_mol_per_l
        Molar extinction ε in 1/(mm M), one entry a wavelength.

    Raises
    ------
    InputError
        A negative or undefined concentration or extinction.

    Examples
    --------
    >>> solute(100.0, np.array([5500.0])).round(4)  # 55 000 1/(cm M), bilirubin at 451 nm
    array([1.2664])
    """
    _non_negative("concentration", concentration_umol_per_l)
    _non_negative("molar extinction", extinction_per_mm_per_mol_per_l)
    return math.log(10.0) * 1e-6 * concentration_umol_per_l * np.asarray(extinction_per_mm_per_mol_per_l, dtype=float)


def power_law(wavelength_nm: FloatArray, scale: float, exponent: float, reference_nm: float) -> FloatArray:
    """Power law scale · (λ/λ0)^(−exponent), in the scale's unit; melanosomes, for one.

    Examples
    --------
    >>> power_law(np.array([500.0, 1000.0]), 8.0, 3.0, 500.0)
    array([8., 1.])
    """
    return scale * (np.asarray(wavelength_nm, dtype=float) / reference_nm) ** (-exponent)


def exponential_law(wavelength_nm: FloatArray, scale: float, decay_nm: float, reference_nm: float) -> FloatArray:
    """Exponential law scale · e^(−(λ − λ0)/decay), in the scale's unit; bloodless skin, for one.

    Examples
    --------
    >>> exponential_law(np.array([500.0]), 8.0, 66.2, 500.0)
    array([8.])
    """
    return scale * np.exp(-(np.asarray(wavelength_nm, dtype=float) - reference_nm) / decay_nm)


def _share(what: str, value: float) -> None:
    if not 0.0 <= value <= 1.0:
        raise InputError.of(what, value, "must be within [0, 1]", "Give a share of 1, not a percentage.")


def _non_negative(what: str, value: float | FloatArray) -> None:
    values = np.asarray(value, dtype=float)
    bad = ~(values >= 0)
    if bad.any():
        raise InputError.of(what, float(values[bad].flat[0]), "must be ≥ 0", "Mend the value.")
