"""Claims of a spectral experiment: each criterion computed with its error, or missing with its reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from livlab.criteria import Claim
from livlab.curves import Curve, interpolate, moving_average, normalise, regular_grid
from livlab.errors import InputError, RangeError
from livlab.kinds.shared.references import Known
from livlab.kinds.shared.sections import Processing
from livlab.kinds.spectral.config import CriterionSpec, SpectralExperiment
from livlab.metrics import amplitude_ratio, bootstrap_interval, mse, pearson, rmse
from livlab.metrics import normalise as normalised
from livlab.units import FloatArray

RESAMPLES = 1000
BUDGET = ("specular", "diffuse_reflectance", "transmittance", "absorbed", "lost", "redirect_loss")
"""Where light can go; `residual` is what is in none of them."""

_METRICS = {"pearson": pearson, "rmse": rmse, "mse": mse, "amplitude ratio": amplitude_ratio}


def points(piece: xr.Dataset) -> Curve:
    """The simulated points with their errors."""
    return Curve.of(piece["wavelength"].to_numpy(), piece["value"].to_numpy(), piece["standard_error"].to_numpy())


def processed(curve: Curve, how: Processing) -> Curve:
    """Interpolated and smoothed, not yet normalised (Nunes 2019, section 7.1)."""
    if len(curve.value) < 2:
        return curve
    grid = regular_grid(float(curve.wavelength_nm[0]), float(curve.wavelength_nm[-1]), how.interpolate_nm)
    return moving_average(interpolate(curve, grid), how.moving_average, how.alignment)


def shown(curve: Curve, how: Processing) -> tuple[FloatArray, FloatArray]:
    """The processed curve, normalised, and its standard error; nan where nothing above 0 was measured."""
    try:
        made = normalise(curve, how.normalise)
    except InputError:
        nothing = np.full(len(curve.value), np.nan)
        return nothing, nothing
    return made.value, made.standard_error


def judge(
    config: SpectralExperiment, pieces: Mapping[str, xr.Dataset], references: Sequence[Known]
) -> tuple[list[Claim], list[dict[str, object]]]:
    """Every claim, and for each that compares curves the row of metrics.csv with its bootstrap interval.

    Parameters
    ----------
    config
        The experiment.
    pieces
        What the instrument measured, by reading.
    references
        As `load_reference` gives them.
    """
    known = {r.spec.label: r for r in references}
    claims, rows = [], []
    for spec, reading, name in config.claims():
        piece = pieces[reading]
        seconds = float(piece.attrs.get("seconds", 0.0))
        try:
            if spec.needs_reference:
                claim, row = _compared(config, spec, name, piece, known[str(spec.against)], seconds)
                rows += [row] if row else []
            else:
                claim = _counted(spec, name, piece, seconds)
        except (InputError, RangeError) as error:
            claim = Claim.missing(name, error.message, aim=spec.aim, seconds=seconds)
        claims.append(claim)
    return claims, rows


def _compared(
    config: SpectralExperiment, spec: CriterionSpec, name: str, piece: xr.Dataset, known: Known, seconds: float
) -> tuple[Claim, dict[str, object] | None]:
    if known.dataset is None:
        return Claim.missing(name, known.reason, aim=spec.aim, seconds=seconds), None
    curve = points(piece)
    if spec.on == "curve":
        curve = processed(curve, config.processing)
    low, high = spec.band_nm or (curve.wavelength_nm[0], curve.wavelength_nm[-1])
    band = (curve.wavelength_nm >= low) & (curve.wavelength_nm <= high)
    grid = curve.wavelength_nm[band]
    mean, sd = known.at(grid)
    if not np.isfinite(mean).all():
        assert known.dataset is not None
        first, last = known.dataset.range_nm
        raise RangeError.of(
            f"reference {known.spec.label}",
            float(grid[~np.isfinite(mean)][0]),
            f"is outside its range, {first:g}–{last:g} nm",
            "Narrow band_nm.",
        )
    by, metric = config.processing.normalise, _METRICS[spec.metric]

    def compare(a: FloatArray, b: FloatArray) -> float:
        return metric(normalised(a, by), normalised(b, by))

    errors: dict[str, Any] = {
        "reference_error": None if sd is None else sd / np.sqrt(known.spec.subjects),
        "reference_errors": known.spec.errors,
        "resamples": RESAMPLES,
        "seed": config.seed,
    }
    drawn = curve.covariance[np.ix_(band, band)]
    found = bootstrap_interval(compare, curve.value[band], mean, values_error=drawn, **errors)
    judged = partial(Claim.judged, name, found.estimate, found.standard_error, spec.aim, seconds=seconds)
    claim = judged()
    if claim.verdict == "TOO CLOSE" and sd is not None:  # more samples leave the reference's own error as it is
        claim = judged(fixed=bootstrap_interval(compare, curve.value[band], mean, **errors).standard_error)
    row: dict[str, object] = {
        "criterion": name,
        "points": int(band.sum()),
        "value": found.estimate,
        "standard_error": found.standard_error,
        "low_95": found.low,
        "high_95": found.high,
        "bias": found.bias,
        "resamples": found.resamples,
    }
    return claim, row


def _counted(spec: CriterionSpec, name: str, piece: xr.Dataset, seconds: float) -> Claim:
    grid = piece["wavelength"].to_numpy()
    low, high = spec.band_nm or (grid[0], grid[-1])
    inside = piece.isel(wavelength=np.flatnonzero((grid >= low) & (grid <= high)))
    if spec.metric == "energy residual":
        value = float(np.max(np.abs(energy_residual(inside))))
    else:
        largest = float(inside["value"].max())
        if not largest > 0:
            raise InputError.of("largest value", largest, "must be above 0", "Take more samples.")
        value = float(inside["standard_error"].max()) / largest
    return Claim.judged(name, value, 0.0, spec.aim, seconds=seconds)


def energy_residual(piece: xr.Dataset) -> FloatArray:
    """1 less every part of the light that is accounted for, (W,).

    Raises
    ------
    InputError
        The solver did not account for the light.
    """
    total = np.zeros(piece.sizes["wavelength"])
    for part in BUDGET:
        if part not in piece or piece[part].isnull().all():
            raise InputError.of("energy", part, "was not counted by this solver", "Leave the criterion out.")
        share = piece[part]
        total = total + (share.sum("layer") if "layer" in share.dims else share).to_numpy()
    return np.asarray(1.0 - total, dtype=np.float64)
