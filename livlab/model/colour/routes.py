"""Routes from a spectrum to linear RGB as weights on the wavelengths, and the thesis's route with its random variant.

Every route is linear: a channel is Σ w(channel, λ) L(λ) over the wavelengths that an image has. So one product makes
the colour, and the same weights carry the image's standard error to it.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import xarray as xr

from livlab.errors import InputError, RangeError
from livlab.units import FloatArray

CHANNELS = ("R", "G", "B")
CHANNEL_CENTRES_NM = (700.0, 546.1, 435.8)
"""Red, green and blue of Nunes 2019, eq. 6.20; the primaries of the CIE's 1931 experiments."""

Dependence = Literal["any", "independent"]
"""How errors at different wavelengths depend on each other: in any way (a bound), or not at all."""

ROUNDING_NM = 1e-6


def channel_wavelengths(kappa_nm: float, count: int, *, stochastic: bool | str = False, seed: int = 0) -> FloatArray:
    """Wavelengths at which the channels respond (Nunes 2019, eq. 6.20 and the text around it).

    Parameters
    ----------
    kappa_nm
        Half width κ ≥ 0 of a channel in nm.
    count
        Wavelengths a channel, N ≥ 1; 1 is the centre, unless drawn.
    stochastic
        False: regular over [centre − κ, centre + κ], both ends included. True or "stratified": one uniform draw in
        each of N equal parts. "uniform": N independent uniform draws.
    seed
        Of the draws.

    Returns
    -------
    (3, N) wavelengths in nm of R, G and B, each row rising.

    Raises
    ------
    InputError
        A negative or infinite κ, κ that reaches wavelength 0, N < 1, or an unknown way to draw.

    Examples
    --------
    >>> channel_wavelengths(20, 5)[0]
    array([680., 690., 700., 710., 720.])
    >>> channel_wavelengths(1, 1).ravel()
    array([700. , 546.1, 435.8])
    """
    if not (np.isfinite(kappa_nm) and 0 <= kappa_nm < min(CHANNEL_CENTRES_NM)):
        raise InputError.of("kappa_nm", kappa_nm, f"must be within [0, {min(CHANNEL_CENTRES_NM)})", "Give nm, e.g. 20.")
    if isinstance(count, bool) or int(count) != count or count < 1:
        raise InputError.of("count", count, "must be a whole number ≥ 1", "Give wavelengths a channel, e.g. 5.")
    centres = np.array(CHANNEL_CENTRES_NM)[:, None]
    if stochastic is False:
        offsets = np.linspace(-1.0, 1.0, count) if count > 1 else np.zeros(1)
        return np.asarray(centres + kappa_nm * offsets)
    draws = np.random.default_rng(seed).random((3, count))
    if stochastic in (True, "stratified"):
        draws = (np.arange(count) + draws) / count
    elif stochastic != "uniform":
        raise InputError.of("stochastic", stochastic, 'must be False, "stratified" or "uniform"', "Pick one.")
    return np.asarray(np.sort(centres + kappa_nm * (2.0 * draws - 1.0), axis=1))


def thesis_weights(wavelength_nm: Any, kappa_nm: float = 20.0, count: int = 5) -> xr.DataArray:
    """Weights of the thesis's route: the mean of N regular wavelengths within ±κ (Nunes 2019, eq. 6.20).

    A wavelength that the image lacks is interpolated linearly between its neighbours.

    Parameters
    ----------
    wavelength_nm
        (W,) wavelengths of the image in nm, rising.
    kappa_nm, count
        As in `channel_wavelengths`.

    Returns
    -------
    DataArray (channel, wavelength); each channel's weights sum to 1.

    Raises
    ------
    InputError, RangeError
        Bad κ, N or wavelengths; a channel that reaches beyond the image's wavelengths.
    """
    return _mean_weights(wavelength_nm, channel_wavelengths(kappa_nm, count))


def stochastic_weights(
    wavelength_nm: Any, kappa_nm: float = 20.0, count: int = 5, *, stratified: bool = True, seed: int = 0
) -> xr.DataArray:
    """Weights of the mean of N wavelengths drawn within ±κ of each channel's centre; as `thesis_weights` otherwise."""
    how = "stratified" if stratified else "uniform"
    return _mean_weights(wavelength_nm, channel_wavelengths(kappa_nm, count, stochastic=how, seed=seed))


def to_rgb(radiance: xr.DataArray, weights: xr.DataArray) -> xr.DataArray:
    """Linear RGB of a spectrum or a spectral image: Σ w(channel, λ) L(λ).

    Parameters
    ----------
    radiance
        Any dimensions with `wavelength`: radiance over that of a perfect white diffuser under the same light.
    weights
        (channel, wavelength) on the same wavelengths.

    Returns
    -------
    The radiance's dimensions with `channel` (R, G, B) last in the place of `wavelength`; linear, not clipped.

    Raises
    ------
    InputError
        No wavelengths, or other ones than the weights'.
    """
    _check_same(radiance, weights)
    bare = weights.drop_vars("wavelength")  # equal within rounding, which xarray would take for different
    rgb = xr.DataArray(xr.dot(radiance.astype(np.float64), bare, dim="wavelength"))
    rgb = rgb.transpose(*(d for d in radiance.dims if d != "wavelength"), "channel")
    return rgb.rename("rgb").assign_attrs(**weights.attrs, units="1", encoding="linear")


def to_rgb_error(radiance_se: xr.DataArray, weights: xr.DataArray, *, dependence: Dependence = "any") -> xr.DataArray:
    """Standard error of `to_rgb`, from that of the radiance.

    One path serves all wavelengths, so their errors go together in a way that an image's variance does not tell.
    "any" gives Σ |w| σ, which no dependence exceeds; "independent" gives √Σ w²σ², right where each wavelength was
    rendered with its own samples.

    Raises
    ------
    InputError
        As `to_rgb`; a negative error; an unknown dependence.
    """
    _check_same(radiance_se, weights)
    if bool((radiance_se < 0).any()):
        raise InputError.of("radiance_se", float(radiance_se.min()), "must be ≥ 0", "Give standard errors.")
    if dependence == "any":
        error = to_rgb(radiance_se, abs(weights))
    elif dependence == "independent":
        error = to_rgb(radiance_se**2, weights**2) ** 0.5
    else:
        raise InputError.of("dependence", dependence, 'must be "any" or "independent"', "Pick one.")
    return error.rename("rgb_se").assign_attrs(units="1", encoding="linear", dependence=dependence)


def thesis_rgb(radiance: xr.DataArray, kappa_nm: float = 20.0, count: int = 5) -> xr.DataArray:
    """Colour as the thesis makes it, its channels taken as linear sRGB (Nunes 2019, eq. 6.20).

    The thesis's channels are three narrow bands and know neither an illuminant nor an observer; to take them as
    sRGB's is its convention. Arguments, result and errors as of `thesis_weights` and `to_rgb`.
    """
    return to_rgb(radiance, thesis_weights(_wavelengths(radiance), kappa_nm, count))


def stochastic_rgb(
    radiance: xr.DataArray, kappa_nm: float = 20.0, count: int = 5, *, stratified: bool = True, seed: int = 0
) -> xr.Dataset:
    """Colour from wavelengths drawn at random within each channel, and the standard error that the draw adds.

    The draw is one for the whole image, so its error tints the image rather than adding grain. Its standard error is
    estimated from the drawn wavelengths themselves: s/√N for independent draws. For stratified draws the spread
    within a stratum is taken from second differences, s² = mean (y_(i−1) − 2y_i + y_(i+1))²/6, in which a slope
    cancels and a curvature counts as spread (N = 2: from the first difference, in which a slope counts too).

    Returns
    -------
    Dataset with `rgb` and `rgb_se` (nan where N = 1: one draw tells no spread); attribute `wavelengths_nm`.

    Raises
    ------
    InputError, RangeError
        As `stochastic_weights` and `to_rgb`.
    """
    grid = _wavelengths(radiance)
    how = "stratified" if stratified else "uniform"
    drawn = channel_wavelengths(kappa_nm, count, stochastic=how, seed=seed)
    rgb = to_rgb(radiance, _mean_weights(grid, drawn))
    errors = []
    for row in drawn:
        if count < 2:
            errors.append(xr.full_like(radiance.isel(wavelength=0, drop=True), np.nan, dtype=np.float64))
            continue
        at = xr.DataArray(_hat(grid, row), dims=("draw", "wavelength"))
        values = xr.DataArray(xr.dot(radiance.astype(np.float64), at, dim="wavelength"))
        errors.append((_spread(values, stratified) / count) ** 0.5)
    error = xr.concat(errors, dim=xr.DataArray(list(CHANNELS), dims="channel", name="channel"))
    error = error.transpose(*rgb.dims).rename("rgb_se").assign_attrs(units="1", encoding="linear")
    return xr.Dataset(
        {"rgb": rgb, "rgb_se": error},
        attrs={"wavelengths_nm": drawn.ravel().tolist(), "draw": how, "seed": seed},
    )


def check_wavelengths(wavelength_nm: Any) -> FloatArray:
    """Wavelengths in nm as an array; raises `InputError` unless they are positive and rise."""
    grid = np.asarray(wavelength_nm, dtype=np.float64)
    if grid.ndim != 1 or not grid.size or not np.all(np.isfinite(grid) & (grid > 0)) or np.any(np.diff(grid) <= 0):
        raise InputError.of("wavelength", grid.tolist(), "must be positive and rise", "Sort the image by wavelength.")
    return grid


def _wavelengths(radiance: xr.DataArray) -> FloatArray:
    if "wavelength" not in radiance.dims or "wavelength" not in radiance.coords:
        raise InputError.of("radiance", radiance.dims, "needs a dimension wavelength in nm", "Name its wavelengths.")
    return check_wavelengths(radiance["wavelength"].to_numpy())


def _check_same(radiance: xr.DataArray, weights: xr.DataArray) -> None:
    grid, known = _wavelengths(radiance), weights["wavelength"].to_numpy()
    if grid.shape != known.shape or np.any(np.abs(grid - known) > ROUNDING_NM):
        raise InputError.of("weights", known.tolist(), "are for other wavelengths than the image's", "Make them anew.")


def _spread(values: xr.DataArray, stratified: bool) -> xr.DataArray:
    """Variance of one draw, or of one draw within its stratum."""
    if not stratified:
        return values.var("draw", ddof=1)
    order = min(2, values.sizes["draw"] - 1)
    return (values.diff("draw", order) ** 2).mean("draw") / (2.0 if order == 1 else 6.0)


def _mean_weights(wavelength_nm: Any, channels: FloatArray) -> xr.DataArray:
    grid = check_wavelengths(wavelength_nm)
    weights = np.stack([_hat(grid, row).mean(axis=0) for row in channels])
    return xr.DataArray(weights, dims=("channel", "wavelength"), coords={"channel": list(CHANNELS), "wavelength": grid})


def _hat(grid: FloatArray, asked: FloatArray) -> FloatArray:
    """(A, W) weights of linear interpolation from a grid to the wavelengths asked for."""
    outside = (asked < grid[0] - ROUNDING_NM) | (asked > grid[-1] + ROUNDING_NM)
    if outside.any():
        raise RangeError.of(
            "wavelength_nm",
            float(asked[outside][0]),
            f"a channel needs it, and the image has {grid[0]:g}–{grid[-1]:g} nm",
            "Render it too, or take a smaller κ.",
        )
    return np.stack([np.interp(asked, grid, unit) for unit in np.eye(len(grid))], axis=1)
