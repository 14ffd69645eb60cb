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
