"""How far two measured BRDFs lie apart, where both have values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from livlab.brdf.lookup import lookup
from livlab.brdf.table import as_samples, as_table
from livlab.errors import InputError

FloatArray = npt.NDArray[np.float64]


def difference(first: xr.Dataset, second: xr.Dataset) -> dict[str, float]:
    """Difference of two BRDFs, samples or tables, over the samples (or middles of cells) of the first.

    The second is looked up in its cells, samples being merged first. Weights are cos θ_i cos θ_o, so that grazing
    directions, where any BRDF is large and ill known, do not decide. A grey file is compared with the mean
    of the other's channels.

    Returns
    -------
    compared
        Share of the first's directions at which the second has a value.
    mean_difference
        Weighted mean of second minus first, 1/sr.
    rmse
        Weighted root mean square difference, 1/sr, over all channels.
    relative
        That over the weighted root mean square of the first.
    scale
        Factor on the second that fits the first best; 1 where both are absolute and right.
    relative_scaled
        `relative` after that factor.
    pearson
        Weighted correlation coefficient.

    Raises
    ------
    InputError
        Channels that differ in number, or no direction in common.
    """
    a = as_samples(first)
    b = as_table(second)
    if a.sizes["channel"] != b.sizes["channel"] and 1 not in (a.sizes["channel"], b.sizes["channel"]):
        counts = f"{a.sizes['channel']} and {b.sizes['channel']} channels"
        raise InputError.of("files", counts, "must have as many channels", "Compare files of one kind.")
    wi, wo = a["wi"].values, a["wo"].values
    x, y = a["value"].values, lookup(b, wi, wo)
    if x.shape[1] != y.shape[1]:
        x, y = x.mean(axis=1, keepdims=True), y.mean(axis=1, keepdims=True)
    both = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
    if both.sum() < 3:
        raise InputError.of("files", int(both.sum()), "have fewer than three directions in common", "Check the files.")
    weight = np.repeat((wi[both, 2] * wo[both, 2])[:, None], x.shape[1], axis=1).ravel()
    p, q = x[both].ravel(), y[both].ravel()
    mean = float(np.average(q - p, weights=weight))
    rmse = _rms(q - p, weight)
    scale = float(np.sum(weight * p * q) / np.sum(weight * q * q))
    dp, dq = p - np.average(p, weights=weight), q - np.average(q, weights=weight)
    power = np.sum(weight * dp**2) * np.sum(weight * dq**2)
    return {
        "compared": float(both.mean()),
        "mean_difference": mean,
        "rmse": rmse,
        "relative": rmse / _rms(p, weight),
        "scale": scale,
        "relative_scaled": _rms(scale * q - p, weight) / _rms(p, weight),
        "pearson": float(np.sum(weight * dp * dq) / np.sqrt(power)) if power > 0 else float("nan"),
    }


def _rms(x: FloatArray, weight: FloatArray) -> float:
    return float(np.sqrt(np.average(x**2, weights=weight)))
