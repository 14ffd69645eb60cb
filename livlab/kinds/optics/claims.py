"""Claims of an optics experiment; every number is exact to rounding, so its standard error is 0."""

from __future__ import annotations

import time

import numpy as np
import xarray as xr

from livlab.criteria import Claim
from livlab.kinds.optics.config import OpticsCriterion, OpticsExperiment
from livlab.metrics import pearson, rmse
from livlab.model.tissue.particles.sphere import mie, size_parameter
from livlab.units import FloatArray


def scattering_claims(data: xr.Dataset, config: OpticsExperiment) -> list[Claim]:
    """Mie held against Rayleigh, curve by curve.

    Parameters
    ----------
    data
        As `optics_figures.scattering` returns it.
    config
        The experiment.
    """
    claims = []
    for c in config.criterion:
        started = time.perf_counter()
        at = data.sel(particle=c.of, radius=c.radius_um)
        value = _scattering_value(c.metric, at)
        claims.append(_judge(c, value, started))
    return claims


def published_claims(config: OpticsExperiment) -> list[Claim]:
    """Mie's series held against numbers printed elsewhere."""
    claims = []
    for p in config.published:
        started = time.perf_counter()
        found = mie(p.n_particle / p.n_medium, size_parameter(p.radius_um * 1e-3, p.wavelength_nm, p.n_medium))
        value = float(getattr(found, p.quantity))
        name = f"{p.label}: {p.quantity}"
        claims.append(
            Claim.of(name, value, 0.0, p.value, p.tolerance, group="checks", seconds=time.perf_counter() - started)
        )
    return claims


def absorption_claims(data: xr.Dataset, config: OpticsExperiment) -> list[Claim]:
    """Values, peaks and crossings of absorption spectra.

    Parameters
    ----------
    data
        As `optics_figures.absorption` returns it.
    config
        The experiment.
    """
    grid = data["wavelength"].to_numpy()
    claims = []
    for c in config.criterion:
        started = time.perf_counter()
        curve = data["absorption"].sel(chromophore=c.of).to_numpy()
        if c.metric == "value":
            value, reason = float(np.interp(c.wavelength_nm or 0.0, grid, curve)), "its dataset does not cover it"
        elif c.metric == "peak":
            value, reason = peak(grid, curve, c.band_nm or (0.0, 0.0)), "it has no peak inside the band"
        else:
            other = data["absorption"].sel(chromophore=c.against).to_numpy()
            value, reason = crossing(grid, curve - other, c.band_nm or (0.0, 0.0)), "they do not cross exactly once"
        if np.isfinite(value):
            claims.append(_judge(c, value, started))
        else:
            claims.append(Claim.missing(c.name, reason, aim=c.aim))
    return claims


def peak(wavelength_nm: FloatArray, values: FloatArray, band_nm: tuple[float, float]) -> float:
    """Wavelength of the largest value inside a band, by a parabola through it and its neighbours.

    Returns
    -------
    nm; nan where the largest value lies at the band's end, or a value is missing.

    Examples
    --------
    >>> x = np.arange(500.0, 600.0, 5.0)
    >>> round(peak(x, -((x - 543.0) ** 2), (520, 580)), 6)
    543.0
    """
    inside = np.flatnonzero((wavelength_nm >= band_nm[0]) & (wavelength_nm <= band_nm[1]))
    if inside.size < 3 or not np.isfinite(values[inside]).all():
        return float("nan")
    k = int(inside[np.argmax(values[inside])])
    if k in (inside[0], inside[-1]):
        return float("nan")
    a, b, _ = np.polyfit(wavelength_nm[k - 1 : k + 2] - wavelength_nm[k], values[k - 1 : k + 2], 2)
    return float(wavelength_nm[k] - (b / (2.0 * a) if a < 0 else 0.0))


def crossing(wavelength_nm: FloatArray, difference: FloatArray, band_nm: tuple[float, float]) -> float:
    """Wavelength inside a band where a difference changes its sign, interpolated linearly.

    Returns
    -------
    nm; nan unless it does so exactly once.

    Examples
    --------
    >>> x = np.arange(500.0, 600.0, 5.0)
    >>> crossing(x, x - 543.0, (520, 580))
    543.0
    """
    inside = (wavelength_nm >= band_nm[0]) & (wavelength_nm <= band_nm[1])
    x, y = wavelength_nm[inside], difference[inside]
    places = np.flatnonzero(np.sign(y[:-1]) * np.sign(y[1:]) < 0)
    exact = np.flatnonzero(y == 0)
    if len(places) + len(exact) != 1 or not np.isfinite(y).all():
        return float("nan")
    if len(exact):
        return float(x[exact[0]])
    k = places[0]
    return float(x[k] - y[k] * (x[k + 1] - x[k]) / (y[k + 1] - y[k]))


def _scattering_value(metric: str, at: xr.Dataset) -> float:
    series, law = at["mie"].to_numpy(), at["rayleigh"].to_numpy()
    if metric == "pearson":
        return float(pearson(series, law))
    if metric == "rmse":
        return float(rmse(series / series.max(), law / law.max()))
    if metric == "log ratio":
        return float(np.abs(np.log10(law / series)).mean())
    if metric == "anisotropy":
        return float(at["phase_anisotropy"])
    theta = at["theta"].to_numpy()
    curves = (4.0 * np.pi * at[name].to_numpy() for name in ("phase_mie", "phase_rayleigh"))
    # Evenly spaced angles stand for sin θ dθ of the cosine each.
    return float(rmse(*curves, weights=np.sin(theta)))


def _judge(c: OpticsCriterion, value: float, started: float) -> Claim:
    return Claim.judged(c.name, value, 0.0, c.aim, seconds=time.perf_counter() - started)
