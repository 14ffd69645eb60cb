"""Colour against published values: CIEDE2000 test pairs, ColorChecker, the sRGB formula, colour-science itself."""

import numpy as np
import pytest
import xarray as xr

from livlab.model.colour import (
    ILLUMINANTS,
    OBSERVERS,
    SRGB_TO_XYZ,
    cie_rgb,
    cie_weights,
    decode_srgb,
    delta_e_2000,
    encode_srgb,
    sampling_error,
)
from livlab.model.colour.science import colour_science

# Sharma, Wu & Dalal 2005, table 1: L*, a*, b* of both colours, ΔE00.
SHARMA = np.array(
    [
        [50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425],
        [50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615],
        [50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412],
        [50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669],
        [50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0010, -2.4900, 4.8045],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461],
        [50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065],
        [50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492],
        [50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977],
        [50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030],
        [50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.2972, 0.0000, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 1.8634, 0.5757, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.2592, 0.3350, 1.0000],
        [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
        [63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630],
        [61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731],
        [35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645],
        [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
        [36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146],
        [90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441],
        [90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381],
        [6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377],
        [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
    ]
)

# Classic ColorChecker, 8-bit sRGB as its maker printed it (X-Rite 2005, "sRGB coordinates"): rows as on the chart.
PRINTED_SRGB = np.array(
    [
        [115, 82, 68], [194, 150, 130], [98, 122, 157], [87, 108, 67], [133, 128, 177], [103, 189, 170],
        [214, 126, 44], [80, 91, 166], [193, 90, 99], [94, 60, 108], [157, 188, 64], [224, 163, 46],
        [56, 61, 150], [70, 148, 73], [175, 54, 60], [231, 199, 31], [187, 86, 149], [8, 133, 161],
        [243, 243, 242], [200, 200, 200], [160, 160, 160], [122, 122, 121], [85, 85, 85], [52, 52, 52],
    ]
)  # fmt: skip


@pytest.fixture(scope="module")
def checker() -> xr.DataArray:
    """Spectral reflectance of the chart's 24 patches (Ohta), 380–780 nm by 5."""
    table = colour_science().SDS_COLOURCHECKERS["ColorChecker N Ohta"]
    values = np.array([patch.values for patch in table.values()])
    grid = next(iter(table.values())).wavelengths
    return xr.DataArray(values, dims=("patch", "wavelength"), coords={"patch": list(table), "wavelength": grid})


def test_ciede2000_gives_the_published_differences() -> None:
    first = xr.DataArray(SHARMA[:, :3], dims=("pair", "channel"))
    second = xr.DataArray(SHARMA[:, 3:6], dims=("pair", "channel"))
    for a, b in ((first, second), (second, first)):
        found = delta_e_2000(a, b, space="lab")
        assert found.dims == ("pair",)
        # The table has four decimals: a rounded one is at most half its last digit off.
        assert np.abs(found.to_numpy() - SHARMA[:, 6]).max() <= 0.00005 + 1e-9


def test_difference_of_linear_srgb_is_that_of_its_lab() -> None:
    science = colour_science()
    rng = np.random.default_rng(3)
    a, b = rng.random((2, 7, 3))
    found = delta_e_2000(xr.DataArray(a, dims=("n", "channel")), xr.DataArray(b, dims=("n", "channel")))
    white = np.array([0.3127, 0.3290])
    labs = [
        science.XYZ_to_Lab(science.RGB_to_XYZ(x, "sRGB", illuminant=white, chromatic_adaptation_transform=None), white)
        for x in (a, b)
    ]
    # colour-science uses the matrix that IEC 61966-2-1 prints to four digits.
    assert np.abs(found.to_numpy() - science.delta_E(*labs, method="CIE 2000")).max() < 0.02


def test_colorchecker_comes_out_as_its_maker_printed_it(checker: xr.DataArray) -> None:
    printed = xr.DataArray(decode_srgb(PRINTED_SRGB / 255.0), dims=("patch", "channel"))
    difference = delta_e_2000(cie_rgb(checker), printed)
    # Another chart than the maker's, 8 bits, and cyan lies outside sRGB: charts themselves differ by about 1.
    assert float(difference.mean()) < 1.5
    assert float(difference.max()) < 3.0
    assert float(delta_e_2000(cie_rgb(checker), printed.isel(channel=[2, 1, 0])).mean()) > 10.0


def test_thirty_charts_mean_comes_out_as_the_maker_measured_it() -> None:
    """BabelColor's mean of 30 charts against X-Rite's xyY under D50, before any conversion to sRGB."""
    science = colour_science()
    table = science.SDS_COLOURCHECKERS["BabelColor Average"]
    grid = next(iter(table.values())).wavelengths
    spectra = xr.DataArray(
        np.array([patch.values for patch in table.values()]), dims=("patch", "wavelength"), coords={"wavelength": grid}
    )
    kept = cie_rgb(spectra, "D50", adaptation="none").to_numpy() @ SRGB_TO_XYZ.T
    white = SRGB_TO_XYZ @ cie_weights(grid, "D50", adaptation="none").sum("wavelength").to_numpy()
    known = science.CCS_COLOURCHECKERS["ColorChecker24 - Before November 2014"]
    theirs = science.XYZ_to_Lab(science.xyY_to_XYZ(np.array(list(known.data.values()))), known.illuminant)
    ours = science.XYZ_to_Lab(kept, science.XYZ_to_xy(white))
    difference = delta_e_2000(
        xr.DataArray(ours, dims=("patch", "channel")), xr.DataArray(theirs, dims=("patch", "channel")), space="lab"
    )
    assert float(difference.mean()) < 1.0  # what an eye just sees
    assert float(difference.max()) < 1.5


@pytest.mark.parametrize("observer", OBSERVERS)
@pytest.mark.parametrize("illuminant", ["D65", "A", "E", "FL11", "LED-B3"])
def test_tristimulus_agrees_with_colour_science(checker: xr.DataArray, observer: str, illuminant: str) -> None:
    science = colour_science()
    functions = science.MSDS_CMFS[OBSERVERS[observer]]
    light = science.SDS_ILLUMINANTS[illuminant].copy()
    shape = science.SpectralShape(
        max(functions.shape.start, light.shape.start), min(functions.shape.end, light.shape.end), 1
    )
    light = light.align(shape, interpolator=science.LinearInterpolator)
    kept = cie_rgb(checker, illuminant, observer, adaptation="none", interpolation="linear")
    ours = kept.to_numpy() @ SRGB_TO_XYZ.T
    for k in (0, 5, 14, 18):
        values = np.interp(shape.wavelengths, checker["wavelength"], checker.isel(patch=k))
        theirs = science.sd_to_XYZ(
            science.SpectralDistribution(values, shape.wavelengths),
            functions.copy().align(shape),
            light,
            method="Integration",
        )
        assert np.abs(ours[k] - np.asarray(theirs) / 100.0).max() < 1e-6


def test_ten_nm_tables_of_astm_agree(checker: xr.DataArray) -> None:
    """ASTM E308's own weights at 20 nm, an independent way to the same numbers."""
    science = colour_science()
    coarse = checker.isel(wavelength=slice(None, None, 4))
    ours = cie_rgb(coarse, "D65", adaptation="none").to_numpy() @ SRGB_TO_XYZ.T
    functions = science.MSDS_CMFS[OBSERVERS["cie-1931-2"]]
    for k in range(0, 24, 5):
        theirs = science.sd_to_XYZ(
            science.SpectralDistribution(coarse.isel(patch=k).to_numpy(), coarse["wavelength"].to_numpy()),
            functions,
            science.SDS_ILLUMINANTS["D65"],
            method="ASTM E308",
        )
        assert np.abs(ours[k] - np.asarray(theirs) / 100.0).max() < 1.5e-3


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
@pytest.mark.parametrize("observer", OBSERVERS)
def test_a_perfect_white_is_white(illuminant: str, observer: str) -> None:
    weights = cie_weights(np.arange(390, 731, 10.0), illuminant, observer)
    assert np.abs(weights.sum("wavelength") - 1.0).max() < 1e-12


@pytest.mark.parametrize(
    ("name", "xy"), [("A", (0.44758, 0.40745)), ("D50", (0.34567, 0.35851)), ("E", (1 / 3, 1 / 3))]
)
def test_without_adaptation_white_keeps_the_illuminants_published_chromaticity(
    name: str, xy: tuple[float, float]
) -> None:
    weights = cie_weights(np.arange(360, 781, 5.0), name, adaptation="none")
    xyz = SRGB_TO_XYZ @ weights.sum("wavelength").to_numpy()
    assert xyz[1] == pytest.approx(1.0, abs=1e-12)
    assert xyz[:2] / xyz.sum() == pytest.approx(xy, abs=6e-5)  # CIE 015:2018, table T.3, five decimals


def test_adaptation_is_bradfords_published_matrix() -> None:
    """From A to D65 as Lindbloom prints it for Bradford."""
    printed = np.array(
        [[0.8446965, -0.1179225, 0.3948108], [-0.1366303, 1.1041226, 0.1291718], [0.0798489, -0.1348999, 3.1924009]]
    )
    from livlab.model.colour.observers import _adaptation

    found = _adaptation(np.array([1.09850, 1.0, 0.35585]), np.array([0.95047, 1.0, 1.08883]), "Bradford")
    assert np.abs(found - printed).max() < 1e-5


def test_srgb_is_the_formula_of_the_standard() -> None:
    linear = np.linspace(-0.2, 1.5, 341)
    printed = [12.92 * c if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055 for c in np.abs(linear)]
    assert np.allclose(encode_srgb(linear), np.sign(linear) * printed, rtol=0, atol=1e-15)
    assert np.allclose(encode_srgb(linear[60:]), colour_science().models.eotf_inverse_sRGB(linear[60:]), atol=1e-12)
    # Known pairs: middle grey 18 % is 118 of 255, and 128 of 255 is 21.59 %.
    assert round(float(encode_srgb(np.array(0.18))) * 255) == 118
    assert float(decode_srgb(np.array(128 / 255))) == pytest.approx(0.2158605, abs=1e-7)


def test_coarse_wavelengths_err_as_documented(checker: xr.DataArray) -> None:
    found = sampling_error(checker, (10.0, 20.0))
    assert found.sel(step=10.0).max() < 0.1
    assert 0.05 < found.sel(step=20.0).max() < 0.15
    assert sampling_error(checker, (20.0,), interpolation="linear").max() > 4 * found.sel(step=20.0).max()


def test_importing_colour_science_leaves_numpys_printing_alone() -> None:
    import subprocess
    import sys

    code = (
        "import numpy as np; from livlab.model.colour.science import colour_science; "
        "before = np.get_printoptions(); colour_science(); assert np.get_printoptions() == before, 'changed'"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
