"""The CIE's route: a spectrum under an illuminant, seen by a standard observer, to linear sRGB."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import xarray as xr

from livlab.errors import InputError, RangeError
from livlab.model.colour.difference import SRGB_TO_XYZ, delta_e_2000
from livlab.model.colour.routes import CHANNELS, check_wavelengths, to_rgb
from livlab.model.colour.science import colour_science
from livlab.units import FloatArray

OBSERVERS = {
    "cie-1931-2": "CIE 1931 2 Degree Standard Observer",
    "cie-1964-10": "CIE 1964 10 Degree Standard Observer",
    "cie-2015-2": "CIE 2015 2 Degree Standard Observer",
    "cie-2015-10": "CIE 2015 10 Degree Standard Observer",
}
"""Observers by livlab's name, as colour-science calls them."""

ILLUMINANTS = {
    **{name: name for name in ("A", "D50", "D65", "E", "FL2", "FL7", "FL11")},
    **{name: name for name in ("LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1")},
    "xenon": "Kinoton 75P",
}
"""Illuminants by livlab's name: the CIE's (CIE 015:2018), and a measured xenon arc lamp of a projector."""

Interpolation = Literal["linear", "cubic"]
Adaptation = Literal["Bradford", "CAT16", "Von Kries", "none"]

UNSEEN = 1e-2
"""Share of white's luminance beyond an image's wavelengths above which the route refuses."""

STEP_NM = 1.0


def cie_weights(
    wavelength_nm: Any,
    illuminant: str = "D65",
    observer: str = "cie-1931-2",
    *,
    white: xr.DataArray | None = None,
    adaptation: Adaptation = "Bradford",
    interpolation: Interpolation = "cubic",
) -> xr.DataArray:
    """Weights from a spectrum to linear sRGB: illuminant × observer, adapted so that white is (1, 1, 1).

    XYZ_k = Σ S x̄_k L / Σ S ȳ W at 1 nm (CIE 015:2018, 7.1), L interpolated between the image's wavelengths and held
    at their ends, W white's spectrum; then chromatic adaptation from W's XYZ to sRGB's white, and sRGB's matrix.

    Parameters
    ----------
    wavelength_nm
        (W,) wavelengths of the image in nm, rising.
    illuminant, observer
        A name in `ILLUMINANTS` and one in `OBSERVERS`.
    white
        (wavelength,) radiance of what is to come out white; a perfect white diffuser if not given. It must have the
        image's wavelengths.
    adaptation
        "Bradford" (as ICC profiles do), "CAT16", "Von Kries" (Hunt–Pointer–Estevez), or "none": the illuminant's
        colour stays in the image, and only luminance is scaled to white's.
    interpolation
        "cubic": spline through the wavelengths (not-a-knot; linear with fewer than four). "linear".

    Returns
    -------
    DataArray (channel, wavelength). Attributes: `illuminant`, `observer`, `adaptation`, `interpolation`,
    `unseen_share` (share of white's luminance beyond the image's wavelengths, where the end is held).

    Raises
    ------
    InputError
        An unknown name; wavelengths that do not rise; a white that is not positive or has other wavelengths.
    RangeError
        More than `UNSEEN` of white's luminance lies beyond the image's wavelengths.

    Examples
    --------
    >>> weights = cie_weights(np.arange(380, 781, 10), "A")
    >>> weights.sum("wavelength").to_numpy().round(12)
    array([1., 1., 1.])
    """
    grid = check_wavelengths(wavelength_nm)
    if adaptation not in ("Bradford", "CAT16", "Von Kries", "none"):
        raise InputError.of("adaptation", adaptation, "must be Bradford, CAT16, Von Kries or none", "Pick one.")
    fine, power, sensitivity = _tables(illuminant, observer)
    between = _interpolator(grid, fine, interpolation)
    seen = sensitivity * power
    beyond = (fine < grid[0]) | (fine > grid[-1])
    unseen = float(seen[1, beyond].sum() / seen[1].sum())
    if unseen > UNSEEN:
        raise RangeError.of(
            "wavelength",
            f"{grid[0]:g}–{grid[-1]:g} nm",
            f"leaves out {100 * unseen:.1f} % of white's luminance under {illuminant}, more than {100 * UNSEEN:g} %",
            "Render 400–700 nm or more.",
        )
    to_xyz = seen @ between
    of_white = to_xyz @ _white(white, grid)
    to_xyz /= of_white[1]
    of_white /= of_white[1]
    target = SRGB_TO_XYZ.sum(axis=1)
    if adaptation != "none":
        to_xyz = _adaptation(of_white, target, adaptation) @ to_xyz
    return xr.DataArray(
        np.linalg.solve(SRGB_TO_XYZ, to_xyz),
        dims=("channel", "wavelength"),
        coords={"channel": list(CHANNELS), "wavelength": grid},
        attrs={
            "illuminant": illuminant,
            "observer": observer,
            "adaptation": adaptation,
            "interpolation": interpolation,
            "unseen_share": unseen,
        },
    )


def cie_rgb(
    radiance: xr.DataArray,
    illuminant: str = "D65",
    observer: str = "cie-1931-2",
    *,
    white: xr.DataArray | None = None,
    adaptation: Adaptation = "Bradford",
    interpolation: Interpolation = "cubic",
) -> xr.DataArray:
    """Linear sRGB of a spectrum or spectral image as an observer sees it under an illuminant; see `cie_weights`.

    Parameters
    ----------
    radiance
        Any dimensions with `wavelength` in nm: radiance over that of a perfect white diffuser under the same light,
        so the illuminant's spectrum is not in it.

    Returns
    -------
    As `to_rgb`: not clipped; colours that a screen cannot show keep values outside [0, 1].
    """
    grid = radiance["wavelength"].to_numpy() if "wavelength" in radiance.coords else np.zeros(0)
    return to_rgb(
        radiance,
        cie_weights(grid, illuminant, observer, white=white, adaptation=adaptation, interpolation=interpolation),
    )


def sampling_error(spectra: xr.DataArray, steps_nm: Sequence[float] = (5.0, 10.0, 20.0), **how: Any) -> xr.DataArray:
    """Colour difference ΔE00 that coarser wavelengths make, against all the wavelengths that the spectra have.

    Parameters
    ----------
    spectra
        (…, wavelength) on regular wavelengths finer than every step.
    steps_nm
        Steps; each a multiple of the spectra's own. Samples start at the first wavelength.
    how
        Further arguments of `cie_rgb`.

    Returns
    -------
    DataArray (step, …) of ΔE00.

    Raises
    ------
    InputError
        A step that is no multiple of the spectra's own.
    """
    grid = check_wavelengths(spectra["wavelength"].to_numpy())
    own = float(grid[1] - grid[0]) if len(grid) > 1 else float("nan")
    best = cie_rgb(spectra, **how)
    found = []
    for step in steps_nm:
        stride = round(step / own) if np.isfinite(own) else 0
        if stride < 1 or abs(stride * own - step) > 1e-6 or not np.allclose(np.diff(grid), own):
            raise InputError.of("steps_nm", step, f"must be a multiple of the spectra's {own:g} nm", "Mend the step.")
        found.append(delta_e_2000(cie_rgb(spectra.isel(wavelength=slice(None, None, stride)), **how), best))
    return xr.concat(found, dim=xr.DataArray(list(steps_nm), dims="step", name="step", attrs={"units": "nm"}))


@lru_cache(maxsize=64)
def _tables(illuminant: str, observer: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Wavelengths (F,) at 1 nm, the illuminant's power (F,) and the observer's functions (3, F)."""
    for name, value, known in (("illuminant", illuminant, ILLUMINANTS), ("observer", observer, OBSERVERS)):
        if value not in known:
            raise InputError.of(name, value, f"must be one of {', '.join(known)}", "Pick one.")
    colour = colour_science()
    functions = colour.MSDS_CMFS[OBSERVERS[observer]]
    name = ILLUMINANTS[illuminant]
    light = colour.SDS_ILLUMINANTS[name] if name in colour.SDS_ILLUMINANTS else colour.SDS_LIGHT_SOURCES[name]
    low = max(functions.wavelengths[0], light.wavelengths[0])
    high = min(functions.wavelengths[-1], light.wavelengths[-1])
    fine = np.arange(low, high + STEP_NM / 2, STEP_NM)
    # The CIE tabulates its illuminants for linear interpolation (CIE 015:2018, 4).
    power = np.interp(fine, light.wavelengths, light.values)
    sensitivity = np.stack([np.interp(fine, functions.wavelengths, column) for column in functions.values.T])
    return fine, power, sensitivity


def _interpolator(grid: FloatArray, fine: FloatArray, how: str) -> FloatArray:
    """(F, W) matrix from values at an image's wavelengths to values at 1 nm; the ends are held."""
    if how not in ("linear", "cubic"):
        raise InputError.of("interpolation", how, 'must be "linear" or "cubic"', "Pick one.")
    inside = np.clip(fine, grid[0], grid[-1])
    units = np.eye(len(grid))
    if how == "linear" or len(grid) < 4:
        return np.stack([np.interp(inside, grid, unit) for unit in units], axis=1)
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(grid, units)(inside))


def _white(white: xr.DataArray | None, grid: FloatArray) -> FloatArray:
    if white is None:
        return np.ones(len(grid))
    known = white["wavelength"].to_numpy() if "wavelength" in white.coords else np.zeros(0)
    if white.dims != ("wavelength",) or known.shape != grid.shape or not np.allclose(known, grid):
        raise InputError.of("white", dict(white.sizes), "must have the image's wavelengths alone", "Interpolate it.")
    values = np.asarray(white.to_numpy(), dtype=np.float64)
    if not np.all(np.isfinite(values) & (values >= 0)) or not values.any():
        raise InputError.of("white", values.tolist(), "must be finite, ≥ 0 and not all 0", "Mend it.")
    return values


def _adaptation(source: FloatArray, target: FloatArray, how: str) -> FloatArray:
    matrix = colour_science().adaptation.matrix_chromatic_adaptation_VonKries
    return np.asarray(matrix(source, target, transform=how))
