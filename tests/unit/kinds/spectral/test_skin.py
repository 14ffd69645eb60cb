"""The preset skin does what published skin does: its coefficients are the sources', its curves have their shape."""

from __future__ import annotations

import numpy as np
import pytest

import livlab
from livlab.model.tissue.optics import coefficients
from livlab.model.tissue.readings import READINGS

GRID = np.arange(450.0, 701.0, 4.0)


@pytest.fixture(scope="module")
def curves() -> dict[str, livlab.Spectrum]:
    states = ("light", "moderate", "dark")
    return {s: livlab.spectrum("skin", "measured", GRID, state=s, solver="adding-doubling") for s in states}


def test_the_coefficients_are_those_of_the_sources() -> None:
    found = coefficients(livlab.tissue("skin"), READINGS["measured"], [500.0, 700.0])
    epidermis, dermis = found.sel(layer="epidermis"), found.sel(layer="dermis")
    for k, nm in enumerate((500.0, 700.0)):
        melanosome = 1.70e12 * nm**-3.48 / 10  # 1/mm
        baseline = (0.244 + 85.3 * np.exp(-(nm - 154) / 66.2)) / 10
        np.testing.assert_allclose(epidermis["absorption"].sel(element="melanosomes")[k], 0.04 * melanosome, rtol=1e-12)
        np.testing.assert_allclose(epidermis["absorption"].sel(element="baseline")[k], 0.96 * baseline, rtol=1e-12)
        for layer, a, ray, mie in ((epidermis, 66.7, 0.29, 0.689), (dermis, 43.6, 0.41, 0.562)):
            part = layer.sel(element="structure").isel(wavelength=k)
            reduced = a * (ray * (nm / 500) ** -4 + (1 - ray) * (nm / 500) ** -mie) / 10
            np.testing.assert_allclose(part["scattering"] * (1 - part["anisotropy"]), reduced, rtol=1e-12)


def test_the_readings_that_keep_the_light_agree_on_skin(curves: dict[str, livlab.Spectrum]) -> None:
    other = livlab.spectrum("skin", "consistent", GRID[::10], solver="adding-doubling")
    np.testing.assert_allclose(other.value, curves["light"].value[::10], atol=2e-5)
    thesis = livlab.spectrum("skin", "thesis", GRID[::10], solver="adding-doubling")
    assert (thesis.value < 0.5 * other.value).all()  # Algorithm 2 removes light at each scattering


def test_melanin_darkens_at_every_wavelength_and_most_in_the_blue(curves: dict[str, livlab.Spectrum]) -> None:
    light, moderate, dark = (curves[s].value for s in ("light", "moderate", "dark"))
    assert (moderate < light).all()
    assert (dark < moderate).all()
    ratio = dark / light
    assert ratio[0] < 0.25 < 0.33 < ratio[-1]
    assert 0.0 < dark.min() < light.max() < 0.7


def test_light_skin_has_the_w_of_oxyhaemoglobin_and_melanin_flattens_it(curves: dict[str, livlab.Spectrum]) -> None:
    depth = []
    for curve in curves.values():
        at = dict(zip(("left", "alpha", "middle", "beta", "right"), curve.at([514, 542, 560, 577, 600]), strict=True))
        depth.append(at["middle"] - (at["alpha"] + at["beta"]) / 2)
        if curve is curves["light"]:
            assert at["left"] > at["alpha"] < at["middle"] > at["beta"] < at["right"]
    assert depth[0] > depth[1] > depth[2]
    blood = livlab.reference("haemoglobin_prahl", "hbo2")
    assert livlab.compare(curves["light"], blood, band_nm=(520, 600)).pearson < -0.85


def test_without_blood_the_w_is_gone_and_without_oxygen_it_is_one_dip() -> None:
    path = "layers.dermis.elements.blood"
    pale = livlab.spectrum("skin", "measured", GRID, changes={f"{path}.fraction": 0.0}, solver="adding-doubling")
    assert (np.diff(pale.value) > 0).all()
    blue = livlab.spectrum("skin", "measured", GRID, changes={f"{path}.oxygenation": 0.0}, solver="adding-doubling")
    inside = (GRID >= 520) & (GRID <= 600)
    dips = np.flatnonzero(np.diff(np.sign(np.diff(blue.value[inside]))) > 0)
    assert len(dips) == 1
    assert GRID[inside][dips[0] + 1] == pytest.approx(555, abs=6)  # deoxyhaemoglobin's single band


def tones() -> dict[int, livlab.Spectrum]:
    """Samples 15 and 18 of CIE 224:2017, which ANSI/IES TM-30 designates as skin tones: a light and a darker one."""
    from colour import SpectralShape
    from colour.quality.cfi2017 import load_TCS_CIE2017

    table = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    return {n: livlab.Spectrum.of(table.wavelengths, table.values[:, n - 1], name=f"sample {n}") for n in (15, 18)}


def test_the_shape_is_that_of_measured_skin_and_the_level_is_darker() -> None:
    """docs/adding-an-organ.md's table: nothing in the preset was tuned to these curves."""
    grid = np.arange(400.0, 701.0, 10.0)
    known = tones()
    melanosomes, baseline = (f"layers.epidermis.elements.{n}.fraction" for n in ("melanosomes", "baseline"))

    def skin(share: float) -> livlab.Spectrum:
        changes = {melanosomes: share, baseline: 1.0 - share}
        return livlab.spectrum("skin", "measured", grid, changes=changes, solver="adding-doubling")

    found = {share: skin(share) for share in (0.013, 0.04, 0.11, 0.30)}
    pearson = {(n, s): livlab.compare(c, known[n]).pearson for n in known for s, c in found.items()}
    assert pearson[15, 0.04] > 0.997
    assert pearson[18, 0.11] > 0.999
    assert pearson[15, 0.30] < 0.98  # so that the bars above say something
    # The light sample lies within the published range of a light skin's melanosomes only at its lightest end.
    ratio = {s: c.value / known[15].at(grid) for s, c in found.items()}
    assert 0.58 < ratio[0.04].min() < ratio[0.04].max() < 0.78
    assert ratio[0.013].min() < 1.0 < ratio[0.013].max()
    # Upper inner arms, 685 nm (Jablonski and Chaplin 2000): 0.193 in Darwin, 0.669 in Mainz.
    assert 0.193 < found[0.04].at([685.0])[0] < 0.669
    assert found[0.30].at([685.0])[0] < 0.193


def test_the_dermis_agrees_with_the_other_form_of_its_row() -> None:
    """Jacques 2013, Table 1 gives each tissue in two forms; a wrong Mie exponent (0.69) would be 8 % off at 1000 nm."""
    found = coefficients(livlab.tissue("skin"), READINGS["measured"], [1000.0])
    part = found.sel(layer="dermis", element="structure")
    reduced = float((part["scattering"] * (1 - part["anisotropy"])).item())
    assert reduced == pytest.approx(45.3 * 2.0**-1.292 / 10, rel=0.01)
