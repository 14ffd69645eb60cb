"""The CIE's route: a spectrum under an illuminant, seen by a standard observer, to linear sRGB."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.colour.difference import delta_e_2000
from livlab.model.colour.guard import check_seen, possible_error, told
from livlab.model.colour.primaries import SRGB_TO_XYZ, lab
from livlab.model.colour.routes import CHANNELS, check_wavelengths, to_rgb
from livlab.model.colour.science import colour_science
from livlab.model.colour.sight import Sight, interpolator, sight
from livlab.units import FloatArray

Interpolation = Literal["linear", "cubic"]
Adaptation = Literal["Bradford", "CAT16", "Von Kries", "none"]


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
    `unseen_share` (share of white's luminance beyond the image's wavelengths, where the end is held),
    `unseen_share_of_x`, `unseen_share_of_z` (the same of its X and Z). What that may mean for the colour of a spectrum
    is `colour_error`'s to say.

    Raises
    ------
    InputError
        An unknown name; wavelengths that do not rise; a white that is not positive or has other wavelengths.
    RangeError
        More than `guard.UNSEEN` of white's luminance, or `guard.UNSEEN_OF_ANY` of its X or Z, lies beyond the image's
        wavelengths, or there is a gap of more than `guard.WIDEST_NM` between them.

    Examples
    --------
    >>> weights = cie_weights(np.arange(380, 781, 10), "A")
    >>> weights.sum("wavelength").to_numpy().round(12)
    array([1., 1., 1.])
    """
    grid = check_wavelengths(wavelength_nm)
    if adaptation not in ("Bradford", "CAT16", "Von Kries", "none"):
        raise InputError.of("adaptation", adaptation, "must be Bradford, CAT16, Von Kries or none", "Pick one.")
    eye = sight(illuminant, observer)
    between = interpolator(grid, eye.fine, interpolation)
    check_seen(grid, eye, illuminant)
    below, above = eye.unseen(grid)
    from_sums = _from_sums(grid, eye, white, adaptation, between)
    return xr.DataArray(
        from_sums @ (eye.seen @ between),
        dims=("channel", "wavelength"),
        coords={"channel": list(CHANNELS), "wavelength": grid},
        attrs={
            "illuminant": illuminant,
            "observer": observer,
            "adaptation": adaptation,
            "interpolation": interpolation,
            **{f"unseen_share{of}": float(below[k] + above[k]) for k, of in ((1, ""), (0, "_of_x"), (2, "_of_z"))},
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


def colour_error(
    radiance: xr.DataArray,
    illuminant: str = "D65",
    observer: str = "cie-1931-2",
    *,
    white: xr.DataArray | None = None,
    adaptation: Adaptation = "Bradford",
) -> xr.DataArray:
    """Colour difference ΔE00 by which `cie_rgb` of a spectrum may be off, as its wavelengths are few or end early.

    Beyond its ends the spectrum may rise or fall by `guard.STEEPEST` a nm, or as steeply as elsewhere, between 0 and
    white: of the four combinations the farthest counts. Between its wavelengths it may be as far from the spline as
    lines are, or a spline through every other wavelength; but no less than known spectra err at that step. Features
    narrower than the step are seen by neither.

    Parameters
    ----------
    radiance, illuminant, observer, white, adaptation
        As of `cie_rgb`.

    Returns
    -------
    DataArray of ΔE00, without the dimension `wavelength`; attribute `told`: what a reader must know of the worst, "" if
    that is not noticeable.

    Raises
    ------
    InputError, RangeError
        As `cie_weights`.

    Examples
    --------
    >>> blood = xr.DataArray([0.05, 0.04, 0.02, 0.3, 0.4, 0.45], {"wavelength": [450.0, 500, 550, 600, 650, 700]})
    >>> bool(colour_error(blood) > 5.0)
    True
    """
    grid = check_wavelengths(radiance["wavelength"].to_numpy() if "wavelength" in radiance.coords else np.zeros(0))
    eye = sight(illuminant, observer)
    check_seen(grid, eye, illuminant)
    to_rgb_ = _from_sums(grid, eye, white, adaptation, interpolator(grid, eye.fine, "cubic"))
    spectra = radiance.transpose(..., "wavelength")
    found = possible_error(grid, spectra.to_numpy().astype(np.float64).reshape(-1, len(grid)), eye, to_rgb_)
    template = spectra.isel(wavelength=0, drop=True)
    worst = float(np.max(found, initial=0.0, where=np.isfinite(found)))
    out = template.copy(data=found.reshape(template.shape)).rename("colour_error").drop_attrs()
    return out.assign_attrs(units="1", told=told(worst, grid, eye) or "")


def daylight_lab(wavelength_nm: Any) -> Callable[[FloatArray], FloatArray]:
    """From (…, W) reflectances on these wavelengths to (…, 3) CIELAB under D65 for the 2° observer.

    White is a perfect diffuser: its a* and b* are 0.

    Raises
    ------
    InputError, RangeError
        As `cie_weights`.

    Examples
    --------
    >>> daylight_lab(np.arange(400, 701, 10))(np.ones(31)).round(6) + 0.0
    array([100.,   0.,   0.])
    """
    weights = cie_weights(wavelength_nm).transpose("channel", "wavelength").to_numpy()
    return lambda curve: lab(np.asarray(curve) @ weights.T)


def daylight_doubt(wavelength_nm: Any, curves: FloatArray) -> str:
    """What a reader must know of `daylight_lab` of (…, W) curves, the worst of them; "" if nothing noticeable."""
    found = np.atleast_2d(np.asarray(curves, dtype=np.float64))
    made = xr.DataArray(found, dims=("curve", "wavelength"), coords={"wavelength": np.asarray(wavelength_nm)})
    return str(colour_error(made).attrs["told"])


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


def _from_sums(
    grid: FloatArray, eye: Sight, white: xr.DataArray | None, adaptation: str, between: FloatArray
) -> FloatArray:
    """(3, 3) from Σ S x̄ L at 1 nm to linear sRGB."""
    of_white = eye.seen @ between @ _white(white, grid)
    scaled, of_white = np.eye(3) / of_white[1], of_white / of_white[1]
    if adaptation != "none":
        scaled = _adaptation(of_white, SRGB_TO_XYZ.sum(axis=1), adaptation) @ scaled
    return np.asarray(np.linalg.solve(SRGB_TO_XYZ, scaled))


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
