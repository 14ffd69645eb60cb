"""Cuts through samples of a BRDF: the plane of incidence, lobes at some incidences, light and eye together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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


LINE_DEG = 0.5
"""Step of the lines beside the samples."""

Evaluate = Callable[[FloatArray, FloatArray], FloatArray]
"""A BRDF: (n, 3) directions wi and wo to (n, channel) values."""


def lobes(
    samples: xr.Dataset,
    lines: Mapping[str, Evaluate],
    incidence_deg: Sequence[float],
    *,
    half_width_deg: float = 0.5,
    bin_deg: float = 2.0,
    out_of_plane_deg: float = 1.5,
) -> xr.Dataset:
    """Means of samples in the plane of incidence, and models as lines through it.

    Parameters
    ----------
    samples
        From `livlab.brdf.sphere.extract`.
    lines
        BRDFs by name: the truth, a fit.
    incidence_deg
        Angles of incidence.
    half_width_deg, bin_deg, out_of_plane_deg
        How far in θ_i and out of the plane a sample counts, and the width of bins of the signed θ_o.

    Returns
    -------
    xr.Dataset
        (incidence, theta, channel) `measured`, with `at_theta` (incidence, theta) where the samples of a bin lie, in
        degrees: θ_o less what their θ_i has too much, so that a mirror peak stays where it is. (incidence, line,
        channel) each of `lines`. NaN where no sample lies. At normal incidence any plane is the plane of incidence.
    """
    at = plane_angles(samples["wi"].to_numpy(), samples["wo"].to_numpy())
    value = samples["value"].to_numpy()
    edges = np.radians(np.arange(-90 - bin_deg / 2, 90 + bin_deg, bin_deg))
    bins, channels = len(edges) - 1, value.shape[1]
    measured = np.full((len(incidence_deg), bins, channels), np.nan)
    place = np.full((len(incidence_deg), bins), np.nan)
    for k, angle in enumerate(np.radians(incidence_deg)):
        normal = angle < np.radians(half_width_deg)
        near = np.abs(at.theta_i - angle) <= np.radians(half_width_deg)
        if not normal:
            near &= at.out_of_plane <= np.radians(out_of_plane_deg)
        where = np.flatnonzero(near)
        side = np.sign(samples["wo"].to_numpy()[where, 0]) * at.theta_o[where] if normal else at.signed[where]
        theta = side - (0.0 if normal else 1.0) * (at.theta_i[where] - angle)
        cell = np.clip(np.digitize(theta, edges) - 1, 0, bins - 1)
        count = np.bincount(cell, minlength=bins)
        filled, safe = count > 0, np.maximum(count, 1)
        place[k] = np.where(filled, np.bincount(cell, theta, minlength=bins) / safe, np.nan)
        for c in range(channels):
            measured[k, :, c] = np.where(filled, np.bincount(cell, value[where, c], minlength=bins) / safe, np.nan)
    line = np.arange(-88.0, 88.0 + LINE_DEG / 2, LINE_DEG)
    unit = {"units": "1/sr"}
    return xr.Dataset(
        {
            "measured": (("incidence", "theta", "channel"), measured, unit),
            "at_theta": (("incidence", "theta"), np.degrees(place), {"units": "deg"}),
        }
        | {
            name: (("incidence", "line", "channel"), np.stack([_line(f, a, line) for a in incidence_deg]), unit)
            for name, f in lines.items()
        },
        coords={
            "incidence": ("incidence", np.asarray(incidence_deg, dtype=float), {"units": "deg"}),
            "line": ("line", line, {"units": "deg"}),
            "channel": samples["channel"].to_numpy(),
        },
    )


def _line(evaluate: Evaluate, incidence_deg: float, theta_deg: FloatArray) -> FloatArray:
    """(theta, channel) a BRDF in the plane of incidence; the light at −incidence."""
    a, t = np.radians(incidence_deg), np.radians(theta_deg)
    wi = np.broadcast_to([-np.sin(a), 0.0, np.cos(a)], (len(t), 3))
    return evaluate(wi, np.stack([np.sin(t), np.zeros_like(t), np.cos(t)], axis=1))


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


@dataclass(frozen=True)
class BrdfCut:
    """A cut through a BRDF, one value a wavelength and angle.

    Attributes
    ----------
    angle_deg
        (A,) nominal angles: signed θ_o, or the common angle of light and eye.
    at_deg
        (A,) mean angle of what was averaged there.
    value, error
        (W, A) mean and its standard error in 1/sr; NaN where nothing lies.
    count
        (A,) samples averaged.
    """

    angle_deg: FloatArray
    at_deg: FloatArray
    value: FloatArray
    error: FloatArray
    count: FloatArray


def cut_angles(kind: str, last_deg: float, step_deg: float) -> FloatArray:
    """Nominal angles of a cut: both sides of the normal for one incidence, one side for light and eye together."""
    count = int(np.floor(last_deg / step_deg + 1e-9))
    first = 0 if kind == "collinear" else -count
    return np.asarray(np.arange(first, count + 1, dtype=np.float64) * step_deg)


def sphere_cut(
    samples: xr.Dataset,
    kind: str,
    *,
    incidence_deg: float = 45.0,
    half_width_deg: float = 2.5,
    last_deg: float = 75.0,
    theta_step_deg: float = 5.0,
    phi_step_deg: float = 30.0,
    step_deg: float | None = None,
    least: int = 10,
) -> BrdfCut:
    """Mean of a sphere's samples in the bins of a goniometer's detectors.

    Parameters
    ----------
    samples
        With standard errors where they are known.
    kind
        "incidence" or "collinear".
    half_width_deg
        In θ_i; collinear: in the angle between light and eye.
    phi_step_deg
        The detectors' step: samples up to half of it out of the plane of incidence, in azimuth, count.
    step_deg
        Between the angles of the cut; the detectors' own polar step if not given.
    least
        Bins with fewer samples are left empty.
    """
    at = plane_angles(samples["wi"].to_numpy(), samples["wo"].to_numpy())
    step, half = np.radians(theta_step_deg), np.radians(half_width_deg)
    if kind == "collinear":
        theta, near = 0.5 * (at.theta_i + at.theta_o), at.between <= half
    else:
        azimuth = np.minimum(at.phi, np.pi - at.phi)
        near = np.abs(at.theta_i - np.radians(incidence_deg)) <= half
        near &= (azimuth <= np.radians(phi_step_deg) / 2) | (at.theta_o <= step / 2)
        theta = at.signed
    apart = step_deg or theta_step_deg
    angles = cut_angles(kind, last_deg, apart)
    where = np.flatnonzero(near)
    place = np.rint(theta[where] / np.radians(apart)).astype(int)
    inside = np.abs(theta[where] - place * np.radians(apart)) <= step / 2
    place -= round(angles[0] / apart)
    inside &= (place >= 0) & (place < len(angles))
    where, place = where[inside], place[inside]
    count = np.bincount(place, minlength=len(angles)).astype(float)
    filled, safe = count >= least, np.maximum(count, 1.0)

    def mean(x: FloatArray) -> FloatArray:
        return np.asarray(np.where(filled, np.bincount(place, x, minlength=len(angles)) / safe, np.nan))

    value, error = samples["value"].to_numpy()[where], samples["standard_error"].to_numpy()[where]
    channels = range(value.shape[1])
    return BrdfCut(
        angles,
        np.degrees(mean(theta[where])),
        np.stack([mean(value[:, c]) for c in channels]),
        np.stack([np.sqrt(mean(error[:, c] ** 2) / safe) for c in channels]),
        count,
    )


def flat_cut(
    measured: xr.Dataset,
    kind: str,
    *,
    incidence_deg: float = 45.0,
    last_deg: float = 75.0,
    step_deg: float | None = None,
) -> BrdfCut:
    """The same cut through what the goniometer measured (`livlab.acquire.instruments.goniometer`)."""
    theta = np.degrees(measured["theta_o"].to_numpy())
    step = float(theta[1] - theta[0])
    angles = cut_angles(kind, last_deg, step_deg or step)
    incidences = np.degrees(measured["theta_i"].to_numpy())
    places = np.rint(np.abs(angles) / step).astype(int)
    value, error = (measured[name].to_numpy() for name in ("brdf", "brdf_se"))
    if kind == "collinear":
        rows = [int(np.abs(incidences - a).argmin()) for a in angles]
        row = rows[0]
        picked = [x[:, rows, places, 0].copy() for x in (value, error)]
    else:
        row = int(np.abs(incidences - incidence_deg).argmin())
        phi = np.where(angles < 0, 0, value.shape[3] - 1)
        picked = [x[:, row, places, phi].copy() for x in (value, error)]
    # Straight above there is no azimuth: the whole ring about the normal is one detector.
    share, top = _shares(measured), np.flatnonzero(angles == 0)
    picked[0][:, top] = (value[:, row, 0] * share).sum(1)[:, None]
    picked[1][:, top] = np.sqrt(((error[:, row, 0] * share) ** 2).sum(1))[:, None]
    return BrdfCut(angles, angles, picked[0], picked[1], np.full(len(angles), np.nan))


def _shares(measured: xr.Dataset) -> FloatArray:
    """(phi,) shares of a ring of detectors."""
    width = np.diff(np.asarray(measured["phi"].attrs["edges"], dtype=float))
    return np.asarray(width / width.sum())


def at_angles(cut: BrdfCut, angle_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(W, A) values and errors of a cut between its own angles, by linear interpolation."""
    known = cut.angle_deg
    left = np.clip(np.searchsorted(known, angle_deg, side="right") - 1, 0, len(known) - 2)
    share = np.clip((angle_deg - known[left]) / (known[left + 1] - known[left]), 0.0, 1.0)
    value = (1 - share) * cut.value[:, left] + share * cut.value[:, left + 1]
    error = np.hypot((1 - share) * cut.error[:, left], share * cut.error[:, left + 1])
    return np.asarray(value), np.asarray(error)
