"""Cuts through samples of a BRDF: the plane of incidence, lobes at some incidences, light and eye together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from livlab.units import FloatArray


@dataclass(frozen=True)
class PlaneAngles:
    """Angles of samples, radians.

    Attributes
    ----------
    theta_i, theta_o
        From the normal.
    phi
        Azimuth between light and eye, 0 where they lie on one side, π where they face each other.
    signed
        θ_o, negative on the light's side.
    out_of_plane
        Angle of the eye with the plane of incidence.
    between
        Angle between light and eye.
    """

    theta_i: FloatArray
    theta_o: FloatArray
    phi: FloatArray
    signed: FloatArray
    out_of_plane: FloatArray
    between: FloatArray


def plane_angles(wi: FloatArray, wo: FloatArray) -> PlaneAngles:
    """Angles of pairs of directions in the local frame."""
    theta_i, theta_o = np.arccos(np.clip(wi[:, 2], -1, 1)), np.arccos(np.clip(wo[:, 2], -1, 1))
    across = wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]
    along = wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]
    phi = np.arctan2(np.abs(across), along)
    sine = np.hypot(wi[:, 0], wi[:, 1])
    off = np.where(sine > 0, np.arcsin(np.clip(np.abs(across) / np.where(sine > 0, sine, 1.0), 0, 1)), 0.0)
    between = 2 * np.arcsin(np.clip(np.linalg.norm(wi - wo, axis=1) / 2, 0, 1))
    return PlaneAngles(theta_i, theta_o, phi, np.where(along > 0, -theta_o, theta_o), off, between)


def lobes(
    samples: xr.Dataset,
    others: dict[str, FloatArray],
    incidence_deg: Sequence[float],
    *,
    half_width_deg: float = 1.0,
    bin_deg: float = 2.0,
    out_of_plane_deg: float = 2.0,
) -> xr.Dataset:
    """Means of samples in the plane of incidence, and of other values at the same samples.

    Parameters
    ----------
    samples
        From `livlab.brdf.sphere.extract`.
    others
        (sample, channel) values by name: the truth, a fit.
    incidence_deg
        Angles of incidence.
    half_width_deg, bin_deg, out_of_plane_deg
        How far in θ_i and out of the plane a sample counts, and the width of bins of the signed θ_o.

    Returns
    -------
    xr.Dataset
        (incidence, theta, channel) `measured` and each of `others`; (incidence, theta) `count`. NaN where no sample
        lies. At normal incidence every plane is one of incidence: all samples count, by their θ_o.
    """
    at = plane_angles(samples["wi"].to_numpy(), samples["wo"].to_numpy())
    values = {"measured": samples["value"].to_numpy(), **others}
    edges = np.radians(np.arange(-90 - bin_deg / 2, 90 + bin_deg, bin_deg))
    middle = (edges[1:] + edges[:-1]) / 2
    channels = values["measured"].shape[1]
    out = {name: np.full((len(incidence_deg), len(middle), channels), np.nan) for name in values}
    count = np.zeros((len(incidence_deg), len(middle)), dtype=np.int64)
    for k, angle in enumerate(np.radians(incidence_deg)):
        normal = angle < np.radians(half_width_deg) / 2
        near = np.abs(at.theta_i - angle) <= np.radians(half_width_deg)
        if normal:
            near = at.theta_i <= 2 * np.radians(half_width_deg)
        else:
            near &= at.out_of_plane <= np.radians(out_of_plane_deg)
        where = np.flatnonzero(near)
        cell = np.digitize((at.theta_o if normal else at.signed)[where], edges) - 1
        count[k] = np.bincount(cell, minlength=len(middle))[: len(middle)]
        for name, value in values.items():
            for c in range(channels):
                total = np.bincount(cell, value[where, c], minlength=len(middle))[: len(middle)]
                out[name][k, :, c] = np.where(count[k] > 0, total / np.maximum(count[k], 1), np.nan)
    dims = ("incidence", "theta", "channel")
    return xr.Dataset(
        {name: (dims, value, {"units": "1/sr"}) for name, value in out.items()}
        | {"count": (dims[:2], count, {"units": "1"})},
        coords={
            "incidence": ("incidence", np.asarray(incidence_deg, dtype=float), {"units": "deg"}),
            "theta": ("theta", np.degrees(middle), {"units": "deg"}),
            "channel": samples["channel"].to_numpy(),
        },
    )


def half_angle_map(samples: xr.Dataset, error: FloatArray, bin_deg: float = 2.0) -> xr.Dataset:
    """Count of samples and rms of their relative error in cells of (θ_h, θ_d), over all azimuths."""
    edges = np.radians(np.arange(0.0, 90.0 + bin_deg / 2, bin_deg))
    h, d = samples["theta_h"].to_numpy(), samples["theta_d"].to_numpy()
    count, _, _ = np.histogram2d(h, d, [edges, edges])
    square, _, _ = np.histogram2d(h, d, [edges, edges], weights=np.mean(error**2, axis=1))
    middle = np.degrees((edges[1:] + edges[:-1]) / 2)
    with np.errstate(invalid="ignore"):
        rms = np.sqrt(square / np.where(count > 0, count, np.nan))
    return xr.Dataset(
        {
            "cell_count": (("theta_h", "theta_d"), count.astype(np.int64)),
            "cell_error": (("theta_h", "theta_d"), rms),
        },
        coords={"theta_h": ("theta_h", middle, {"units": "deg"}), "theta_d": ("theta_d", middle, {"units": "deg"})},
    )
