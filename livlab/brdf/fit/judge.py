"""Does a fitted BRDF describe its samples to their noise: per light, per angle, per place in the picture."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from livlab.brdf.fit.data import DIRECTIONS, TILE, Packed
from livlab.brdf.fit.noise import STATED, UNKNOWN, read_curve, variance_curve
from livlab.brdf.fit.problem import BrdfProblem
from livlab.optimise.misfit import Misfit, misfit
from livlab.optimise.structure import Grouping
from livlab.units import FloatArray

IntArray = npt.NDArray[np.intp]

CORE, SQUARE, PLAIN = 1.5e-4, 3e-5, 1e-5
"""Relative errors below which no residual is a misfit: of averaging a lobe over single pixels (its core: 1e-4 rms where
alpha times the radius is 4 px) and over squares (5e-6), and of the search where nothing is averaged."""

MOST = 300_000
"""Samples that are judged at most; of more every n-th."""

THETA_H = (0, 1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50, 60, 75, 90.001)
THETA_D = (0, 10, 20, 30, 40, 50, 60, 70, 80, 90.001)
AZIMUTH = (0, 30, 60, 90, 120, 150, 180.001)
"""Edges of the groups in degrees; azimuths of the half vector are folded, as the symmetry of any material has them."""

REGION = 1 << 40
"""What a packed tile is counted from, for each light."""


def groupings(data: Packed) -> tuple[Grouping, ...]:
    """What residuals may hang on, a label a sample: light, angles, place in the picture, patch of a light."""
    found = [
        Grouping.of("light", data.light, "at light {}"),
        Grouping.bins("theta_h", np.degrees(data.theta_h), THETA_H, "at theta_h {low:g} to {high:.0f} deg"),
        Grouping.bins("theta_d", np.degrees(data.theta_d), THETA_D, "at theta_d {low:g} to {high:.0f} deg"),
        Grouping.bins(
            "azimuth", np.mod(np.degrees(data.phi_h), 180.0), AZIMUTH,
            "at azimuths of the half vector of {low:g} to {high:.0f} deg",
        ),
    ]  # fmt: skip
    if data.footprint != DIRECTIONS:
        place = data.tile % REGION
        found.append(replace(Grouping.of("place in the picture", place), labels=_places(np.unique(place))))
        patches = np.unique(data.tile)
        labels = tuple(
            f"at light {n}, {p.removeprefix('at ')}"
            for n, p in zip(patches // REGION, _places(patches % REGION), strict=True)
        )
        found.append(replace(Grouping.of("place under one light", data.tile), labels=labels, fine=True))
    return tuple(g for g in found if np.unique(g.index).size > 1)


def _places(numbers: IntArray) -> tuple[str, ...]:
    half = TILE // 2
    return tuple(f"at row {n // 65536 * TILE + half}, column {n % 65536 * TILE + half}" for n in numbers.tolist())


def judge(problem: BrdfProblem, values: dict[str, float], inside: list[str], relative: float) -> Misfit:
    """The misfit at an optimum, whatever the loss: residuals over the samples' own noise.

    Parameters
    ----------
    problem, values
        The fit and its optimum.
    inside
        Free parameters that are not at a bound.
    relative
        The residual over the signal, to be told beside.
    """
    data = problem.data
    keep = np.arange(0, data.size, max(1, math.ceil(data.size / MOST)))
    shape = (len(data.channels), keep.size)
    residual, rows = np.empty(shape), np.zeros((len(inside), *shape))
    for c in range(shape[0]):
        predicted = problem.predicted(values, c)
        residual[c] = (predicted - data.value[:, c])[keep]
        names, columns = problem.columns(values, c)
        slope = problem.loss.slope(predicted, c)[keep]
        for name, row in zip(names, columns, strict=True):
            if name in inside:
                rows[inside.index(name), c] = row[keep] / slope
    sd, words, known = _noise(data, keep, residual)
    good = np.isfinite(sd).ravel()
    sd = sd.ravel()[good]
    groups = [replace(g, index=np.tile(g.index[keep], shape[0])[good]) for g in groupings(data)]
    if shape[0] > 1:
        channel = np.repeat(np.arange(shape[0]), keep.size)[good]
        groups.append(Grouping("channel", channel, tuple(f"in channel {c}" for c in data.channels)))
    return misfit(
        residual.ravel()[good] / sd,
        rows.reshape(len(inside), -1)[:, good] / sd,
        groups=groups,
        noise=words,
        known=known,
        noise_dof=data.noise_dof if known else math.inf,
        relative=relative,
    )


def noise_floor(data: Packed) -> float:
    """The relative rms that noise alone would leave, as `BrdfFit.relative_rmse` counts it; NaN if it is not known."""
    weight = (data.pixels * data.cos_i**2)[:, None]
    good = np.isfinite(data.noise)
    if data.noise_from == UNKNOWN or not np.any(good):
        return math.nan
    level = float(np.sum(weight * np.where(good, data.value, 0.0) ** 2))
    # A square of n pixels has 1/n of their variance, as its mean has.
    return math.sqrt(float(np.sum(weight * np.where(good, data.noise, 0.0) ** 2)) / level) if level > 0 else math.nan


def _noise(data: Packed, keep: IntArray, residual: FloatArray) -> tuple[FloatArray, str, bool]:
    """Standard deviations (channels, n), where from, and whether they are known."""
    value = data.value[keep].T
    share = np.where(data.pixels[keep] > 1, SQUARE, CORE) if data.footprint != DIRECTIONS else PLAIN
    floor = share * np.hypot(value, np.median(np.abs(value), axis=1, keepdims=True))
    stated = data.noise[keep].T
    if data.noise_from != UNKNOWN:
        good = np.isfinite(stated) & (stated > 0) if data.noise_from == STATED else np.isfinite(stated)
        return np.where(good, np.hypot(stated, floor), np.nan), data.noise_from, True
    if np.mean((residual / np.maximum(floor, 1e-300)) ** 2) <= 1.0:
        return floor, "the averaging of lobes over pixels", True
    # Unknown: residuals to their own size at each brightness, so that bright samples do not speak alone.
    scale = data.cos_i[keep] * np.sqrt(data.pixels[keep])
    sd = [
        read_curve(variance_curve(v * scale, (r * scale) ** 2), v * scale) / scale
        for v, r in zip(value, residual, strict=True)
    ]
    return np.hypot(np.array(sd), floor), UNKNOWN, False
