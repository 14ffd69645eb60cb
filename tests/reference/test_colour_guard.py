"""What few wavelengths cost a colour: every error that shows is told, and nothing common is refused.

The truth is the colour of the same spectrum at 1 nm from 360 to 830 nm. No model of livlab's made the spectra: layers
of blood (absorption after Prahl's table), melanin and bile over a scatterer, filters with edges, bands, greys, a slope.
"""

from __future__ import annotations

import warnings
from itertools import product

import numpy as np
import pytest
import xarray as xr

from livlab import Spectrum, compare
from livlab.datasets import load
from livlab.errors import RangeError
from livlab.model.colour import (
    SRGB_TO_XYZ,
    cie_rgb,
    cie_weights,
    colour_error,
    daylight_lab,
    decode_srgb,
    delta_e_2000,
    encode_srgb,
    lab,
)
from livlab.model.colour.science import colour_science

FINE = np.arange(360.0, 831.0)
BANDS = [(380, 780), (400, 700), (410, 710), (420, 720), (430, 720), (440, 660), (450, 720), (450, 700), (400, 680)]
STEPS = (5, 10, 20, 30, 40, 60, 80, 160)


def spectra() -> xr.DataArray:
    """Reflectances at 1 nm."""
    table = load("haemoglobin_prahl")
    columns = ("hbo2_molar_extinction_per_cm_per_M", "hb_molar_extinction_per_cm_per_M")
    oxygenated, reduced = (np.interp(FINE, table.wavelength_nm, table.column(c)) for c in columns)
    oxygenated, reduced = oxygenated / oxygenated[FINE == 540], reduced / reduced[FINE == 540]

    def over_scatterer(absorption: np.ndarray) -> np.ndarray:
        return np.exp(-2.2 * np.sqrt(3 * absorption / (absorption + 1.0)))

    def band(centre: float, width: float) -> np.ndarray:
        return np.exp(-4 * np.log(2) * ((FINE - centre) / width) ** 2)

    def edge(centre: float, width: float = 6.0) -> np.ndarray:
        return 1 / (1 + np.exp(-(FINE - centre) / width))

    bile, melanin = band(450, 90), (FINE / 500) ** -3.5
    made = {
        "arterial blood": 0.9 * over_scatterer(2 * oxygenated),
        "venous blood": 0.8 * over_scatterer(1.2 * reduced),
        "thick blood": 0.5 * over_scatterer(5.6 * oxygenated + 2.4 * reduced),
        "liver": 0.7 * over_scatterer(0.125 * (oxygenated + reduced) + 0.3 * bile + 0.05),
        "fatty liver": 0.85 * over_scatterer(0.05 * oxygenated + 0.03 * reduced + 0.1 * bile),
        "skin": 0.75 * over_scatterer(0.03 * oxygenated + 0.15 * melanin),
        "dark skin": 0.6 * over_scatterer(0.03 * oxygenated + 2 * melanin),
        "bile": 0.7 * over_scatterer(0.8 * bile + 0.02),
        "grey": np.full(len(FINE), 0.2),
        "white": np.full(len(FINE), 0.95),
        "slope": np.linspace(0.1, 0.7, len(FINE)),
        **{f"long pass {x}": 0.04 + 0.85 * edge(x) for x in (430, 480, 560, 640)},
        **{f"short pass {x}": 0.89 - 0.85 * edge(x) for x in (440, 580)},
        **{f"band {x}, {w}": 0.03 + 0.8 * band(x, w) for x in (430, 470, 530, 590, 650) for w in (15, 30)},
    }
    return xr.DataArray(
        np.array(list(made.values())), dims=("name", "wavelength"), coords={"name": list(made), "wavelength": FINE}
    )


@pytest.fixture(scope="module")
def truth() -> tuple[xr.DataArray, xr.DataArray]:
    found = spectra()
    return found, cie_rgb(found)


@pytest.mark.parametrize("illuminant", ["D65", "A", "FL11", "LED-RGB1"])
def test_no_colour_that_is_visibly_wrong_goes_untold(illuminant: str) -> None:
    """27 spectra, nine bands, eight steps."""
    every = spectra()
    best = cie_rgb(every, illuminant)
    names = [str(x) for x in every["name"].to_numpy()]
    # Features as wide as the step are seen; of narrower ones nobody can say how bad they are, but that they may be.
    width = np.array([float(x.split(", ")[1]) if ", " in x else 30.0 for x in names])
    wrong = told = within = 0
    for (low, high), step in product(BANDS, STEPS):
        seen = every.sel(wavelength=np.arange(low, high + 0.5, step))
        try:
            possible = colour_error(seen, illuminant)
        except RangeError:
            assert step > 20 or high < 700 or low > 430, (low, high, step)
            continue
        true = delta_e_2000(cie_rgb(seen, illuminant), best)
        silent = (true > 1.0) & (possible <= 1.0)
        assert not silent.any(), (low, high, step, every["name"].to_numpy()[silent.to_numpy()])
        assert bool(possible.attrs["told"]) == bool((possible > 1.0).any())
        wrong += int((true > 1.0).sum())
        told += int((possible > 1.0).sum())
        within += int(((true > 1.0) & (true <= possible)).sum())
        resolved = (width >= step) & (true.to_numpy() > 1.0)
        assert (true.to_numpy() <= 2.0 * possible.to_numpy())[resolved].all(), (low, high, step)
    assert wrong > 300 and told > wrong
    assert within > 0.8 * wrong


def test_common_spectra_every_ten_nanometres_are_neither_refused_nor_doubted(
    truth: tuple[xr.DataArray, xr.DataArray],
) -> None:
    every, best = truth
    for low, high, step in ((400, 700, 10), (400, 700, 5), (380, 780, 10), (400, 720, 10)):
        seen = every.sel(wavelength=np.arange(low, high + 0.5, step))
        possible = colour_error(seen)
        assert (delta_e_2000(cie_rgb(seen), best) <= possible + 0.05).all()
        common = np.array([not str(name).endswith(", 15") for name in every["name"].to_numpy()])
        assert possible.to_numpy()[common].max() <= 1.0, (low, high, step, possible.to_numpy()[common].max())


def test_blood_without_its_violet_is_told_and_three_wavelengths_are_refused() -> None:
    every = spectra()
    blood = every.sel(name="arterial blood")
    seen = blood.sel(wavelength=np.arange(450, 721, 10.0))
    true = float(delta_e_2000(cie_rgb(seen), cie_rgb(blood)))
    found = colour_error(seen)
    assert 1.0 < true <= float(found)
    assert "42.0 % of white's Z lies beyond them" in found.attrs["told"]
    with pytest.raises(RangeError, match="160 nm apart"):
        cie_weights(np.array([400.0, 560.0, 720.0]))
    with pytest.raises(RangeError, match="of white's Z under LED-B3, more than 50 %"):
        cie_weights(np.arange(460.0, 701.0, 10.0), "LED-B3")
    shares = cie_weights(np.arange(450.0, 721.0, 10.0)).attrs
    assert shares["unseen_share"] < 0.006 and shares["unseen_share_of_z"] == pytest.approx(0.42, abs=0.005)


def test_whoever_asks_for_a_colour_is_told() -> None:
    every = spectra()

    def known(name: str, low: float) -> Spectrum:
        seen = every.sel(name=name, wavelength=np.arange(low, 721.0, 10.0))
        return Spectrum.of(seen["wavelength"].to_numpy(), seen.to_numpy(), 1e-3, name=name)

    short, whole = known("liver", 450.0), known("liver", 400.0)
    with pytest.warns(UserWarning, match="liver: 450–720 nm.* leave the colour uncertain by up to ΔE00"):
        short.srgb()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        whole.srgb()
        assert "Colour: 450–720 nm" in short._repr_html_() and "Colour:" not in whole._repr_html_()
    found = compare(short, known("fatty liver", 450.0))
    assert found.delta_e is not None and found.delta_e_error is not None and found.delta_e_error > 2.0
    assert any("uncertain" in note for note in found.notes) and "uncertain" in found._repr_html_()
    assert not compare(whole, known("fatty liver", 400.0)).notes


def test_white_is_neutral_and_the_matrix_is_that_of_the_primaries() -> None:
    science = colour_science()
    grid = np.arange(400.0, 701.0, 10.0)
    for level in (1.0, 0.5, 0.02, 1e-4):
        assert np.abs(daylight_lab(grid)(np.full(len(grid), level))[1:]).max() < 1e-6
        assert np.abs(lab(np.full(3, level))[1:]).max() < 1e-9
    theirs = science.models.rgb.normalised_primary_matrix([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]], [0.3127, 0.3290])
    np.testing.assert_allclose(SRGB_TO_XYZ, theirs, rtol=0, atol=1e-15)
    np.testing.assert_allclose(SRGB_TO_XYZ, science.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ, atol=5e-5)  # 4 digits
    colours = np.random.default_rng(4).uniform(-0.1, 1.2, (200, 3))
    np.testing.assert_allclose(
        lab(colours), science.XYZ_to_Lab(colours @ SRGB_TO_XYZ.T, np.array([0.3127, 0.3290])), atol=1e-10
    )


def test_srgb_goes_there_and_back() -> None:
    linear = np.concatenate([np.linspace(-0.1, 1.2, 20001), 0.0031308 + np.linspace(-1e-6, 1e-6, 201)])
    # The standard's two pieces miss each other by 3e-8 where they meet.
    np.testing.assert_allclose(decode_srgb(encode_srgb(linear)), linear, rtol=0, atol=3e-9)
    eight = np.arange(256) / 255.0
    np.testing.assert_array_equal(np.rint(encode_srgb(decode_srgb(eight)) * 255), np.arange(256))
