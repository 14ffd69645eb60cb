"""How far a BRDF from a sphere, one from a flat sample and a fitted form lie apart, and the claims that follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from livlab import datasets
from livlab.criteria import Claim
from livlab.errors import InputError
from livlab.kinds.brdf.config import REFERENCE, BrdfCriterion, BrdfExperiment
from livlab.kinds.brdf.cuts import BrdfCut, at_angles
from livlab.metrics import bootstrap_interval, mse, pearson, rmse
from livlab.units import FloatArray

COMPARISON = (
    "reading", "wavelength_nm", "between", "points", "rmse", "rmse_se", "noise_rmse", "mse", "mse_se", "pearson",
    "pearson_se", "ratio", "ratio_se",
)  # fmt: skip
PAIRS = {"goniometer": "sphere, goniometer", "fit": "sphere, fit"}
RESAMPLES = 500


@dataclass
class Seen:
    """One reading: its sphere, its flat sample, the cuts through both, and what was fitted."""

    sphere: BrdfCut
    flat: BrdfCut
    measured: xr.Dataset
    samples: xr.Dataset
    wavelength_nm: FloatArray
    fit: Any = None
    fitted: FloatArray | None = None
    seconds: float = 0.0
    comparison: dict[tuple[str, float | None], dict[str, float]] = field(default_factory=dict)


def _ratio(a: FloatArray, b: FloatArray) -> float:
    return float(a.mean() / b.mean())


_METRICS: dict[str, Callable[[FloatArray, FloatArray], float]] = {
    "rmse": rmse,
    "mse": mse,
    "pearson": pearson,
    "ratio": _ratio,
}


def compared(one: Seen, wavelength_nm: FloatArray, nm: float | None, *, seed: int) -> dict[str, dict[str, float]]:
    """RMSE, MSE, Pearson and mean ratio between the cuts at one wavelength, or over all of them, with errors.

    `noise_rmse` is the RMSE that the two standard errors alone would make.
    """
    rows = slice(None) if nm is None else [int(np.flatnonzero(wavelength_nm == nm)[0])]
    here = np.isfinite(one.sphere.at_deg)
    known, known_se = at_angles(one.flat, one.sphere.at_deg[here])
    sphere, sphere_se = one.sphere.value[rows][:, here].ravel(), one.sphere.error[rows][:, here].ravel()
    flat, flat_se = known[rows].ravel(), known_se[rows].ravel()
    found = {PAIRS["goniometer"]: _row(sphere, sphere_se, flat, flat_se, seed)}
    if one.fitted is not None:
        fit = one.fitted[rows][:, here].ravel()
        found[PAIRS["fit"]] = _row(sphere, sphere_se, fit, np.zeros_like(fit), seed)
        found["goniometer, fit"] = _row(flat, flat_se, fit, np.zeros_like(fit), seed)
    return found


def _row(a: FloatArray, a_se: FloatArray, b: FloatArray, b_se: FloatArray, seed: int) -> dict[str, float]:
    row = {"points": float(len(a)), "noise_rmse": float(np.sqrt(np.mean(a_se**2 + b_se**2)))}
    for name, metric in _METRICS.items():
        try:
            found = bootstrap_interval(
                metric, a, b, values_error=a_se, reference_error=b_se, resamples=RESAMPLES, seed=seed
            )
            row |= {name: found.estimate, f"{name}_se": found.standard_error}
        except InputError:  # a constant curve has no correlation
            row |= {name: float("nan"), f"{name}_se": float("nan")}
    return row


def judged(config: BrdfExperiment, seen: dict[str, Seen]) -> list[Claim]:
    """Every criterion with every reading it is asked of."""
    claims = []
    for c in config.criterion:
        for name, one in seen.items():
            if c.of in ("all", name):
                claims.append(_claim(c, name, one))
    return claims


def _claim(c: BrdfCriterion, name: str, one: Seen) -> Claim:
    where = "all wavelengths" if c.wavelength_nm is None else f"{c.wavelength_nm:g} nm"
    label = f"{c.metric} sphere {name} vs {c.against}, {where}"
    if c.metric == "seconds":
        return Claim.judged(f"seconds {name}", one.seconds, 0.0, c.aim, seconds=one.seconds)
    if c.against == "nunes2017":
        return _measured(c, label, one)
    row = one.comparison.get((PAIRS.get(c.against, c.against), c.wavelength_nm))
    key = "ratio" if c.metric == "relative difference" else c.metric
    if row is None or key not in row:
        reason = "nothing was fitted" if c.against == "fit" else "no such comparison in a tissue's run"
        return Claim.missing(label, reason, aim=c.aim)
    value = row[key] - (1.0 if key == "ratio" else 0.0)
    if not np.isfinite(value):
        return Claim.missing(label, "one of the curves is constant", aim=c.aim)
    return Claim.judged(label, value, row[f"{key}_se"], c.aim, seconds=one.seconds)


def _measured(c: BrdfCriterion, label: str, one: Seen) -> Claim:
    """Against Nunes 2017's own numbers, which nobody has until a user adds them.

    The dataset then has a column `angle` (deg or rad; signed θ_o, or the common angle) and a column `brdf` (1/sr); the
    sphere's cut at the wavelength, or its mean over the wavelengths, is held against it where both have values.
    """
    try:
        table = datasets.load(REFERENCE)
    except datasets.ReferenceUnavailable as error:
        reason = f"{error.message} {error.remedy}".strip()
        return Claim.missing(label, reason, aim=c.aim)
    angle = table.column("angle") * (180 / np.pi if table.unit("angle") == "rad" else 1.0)
    order = np.argsort(angle)
    cut = one.sphere
    here = np.isfinite(cut.at_deg) & (cut.at_deg >= angle.min()) & (cut.at_deg <= angle.max())
    if here.sum() < 3:
        reason = f"{REFERENCE} has fewer than three of the cut's angles"
        return Claim.missing(label, reason, aim=c.aim)
    known = np.interp(cut.at_deg[here], angle[order], table.column("brdf")[order])
    if c.wavelength_nm is None:
        value = cut.value[:, here].mean(0)
        error_ = np.sqrt((cut.error[:, here] ** 2).sum(0)) / len(cut.value)
    else:
        w = int(np.flatnonzero(one.wavelength_nm == c.wavelength_nm)[0])
        value, error_ = cut.value[w, here], cut.error[w, here]
    row = _row(value, error_, known, np.zeros_like(known), 0)
    key = "ratio" if c.metric == "relative difference" else c.metric
    shift = 1.0 if key == "ratio" else 0.0
    return Claim.judged(label, row[key] - shift, row[f"{key}_se"], c.aim, seconds=one.seconds)
