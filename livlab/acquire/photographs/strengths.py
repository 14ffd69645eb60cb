"""How strong the lights are, as the pictures have it: each light's gain, and which do not fit the others'."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.shading import Shading, SharedFit, moved_to, patch_sums, tangents_of, terms
from livlab.brdf.geometry import Light

LEAST_GAIN = 0.08
"""Relative error of a light's strength below which nothing is told."""

UNSAID = float(np.deg2rad(1.0))
"""Standard uncertainty that is taken for a direction for which none was said: what mirror balls reach."""

LEAST_SCALE = 0.04
LEAST_GAIN = 0.08
"""Relative error of a scale and of a light's strength below which nothing is told."""


@dataclass(frozen=True, eq=False)
class Gains:
    """Strengths that the pictures ask for, over those declared.

    Attributes
    ----------
    gain, sd
        (lights,) and standard errors, patches of the disc taken as what errs alike; their geometric mean is 1.
    off
        (lights,) gain over what the other lights let expect at that angle from the camera.
    wrong
        (lights,) whether that is beyond `LEAST_GAIN` and five times its scatter.
    spread
        Robust standard deviation of `off`; NaN of fewer than three lights.
    """

    gain: FloatArray
    sd: FloatArray
    off: FloatArray
    wrong: NDArray[np.bool_]
    spread: float


def strengths(
    seen: Shading, fit: SharedFit, lights: Sequence[Light], sd_rad: FloatArray, skip: NDArray[np.bool_]
) -> Gains:
    """Gains of the lights with their errors, and which of them do not fit the others'.

    A material that the shared reflectance cannot follow makes the gain go with the angle from the camera. So a light
    is held against those that stand alike, or, where it stands alone, against a line through all.
    """
    root = np.sqrt(seen.weight)
    power = np.maximum(np.einsum("kp,kp->k", seen.weight, fit.predicted**2), 1e-300)
    scores = patch_sums(seen, fit.residual * root * fit.predicted)
    sd = np.sqrt((scores**2).sum(axis=1)) / power
    place = np.maximum(sd_rad, UNSAID) * _by_place(seen, fit, lights)
    log = np.log(fit.gain)
    eye = -seen.camera.axis if seen.camera.orthographic else seen.camera.centre_mm - seen.centre_mm
    angle = np.arccos(np.clip(seen.directions(lights) @ (eye / np.linalg.norm(eye)), -1, 1))
    use = ~skip
    off, alone = np.zeros(len(log)), np.ones(len(log), dtype=bool)
    if use.sum() < 3:
        return Gains(fit.gain, fit.gain * sd, np.exp(off), ~alone, math.nan)
    trend = _trend(angle[use], log[use])
    left = log - (trend[0] + trend[1] * angle)
    for k in range(len(log)):
        like = use & (np.abs(angle - angle[k]) < _ALIKE_TO_THE_CAMERA)
        like[k] = False
        alone[k] = like.sum() < 2
        off[k] = left[k] if alone[k] else left[k] - float(np.median(left[like]))
    spread = 1.4826 * float(np.median(np.abs(off[use])))
    scale = np.maximum(5 * np.hypot(sd, min(spread, LEAST_GAIN)), 4 * place)
    least = np.where(alone, 3 * LEAST_GAIN, LEAST_GAIN)
    wrong = use & (np.abs(off) > np.maximum(least, scale)) & ((use.sum() >= _ENOUGH) | ~alone)
    return Gains(fit.gain, fit.gain * sd, np.exp(off), wrong, spread)


_ENOUGH = 5
_ALIKE_TO_THE_CAMERA = float(np.deg2rad(15.0))


def _by_place(seen: Shading, fit: SharedFit, lights: Sequence[Light]) -> FloatArray:
    """(lights,) relative change of the gain by an error of the light's direction, per radian in the worse tilt."""
    directions = seen.directions(lights)
    step = 0.01
    made = terms(seen, seen.placed(lights)) @ fit.weights
    power = np.maximum(np.einsum("kp,kp->k", seen.weight, made**2), 1e-300)
    found = []
    for across in tangents_of(directions):
        turned = directions + step * across
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        moved = [moved_to(x, d, seen.centre_mm) for x, d in zip(lights, turned, strict=True)]
        change = terms(seen, seen.placed(moved)) @ fit.weights - made
        found.append(np.einsum("kp,kp->k", seen.weight * made, change) / power / step)
    return np.asarray(np.hypot(*found))


def _trend(angle: FloatArray, log: FloatArray) -> tuple[float, float]:
    """Median line (Theil 1950, Sen 1968)."""
    if len(angle) < 6 or np.ptp(angle) < np.deg2rad(10):
        return float(np.median(log)), 0.0
    i, j = np.triu_indices(len(angle), 1)
    apart = np.abs(angle[i] - angle[j]) > np.deg2rad(5)
    slope = float(np.median((log[i] - log[j])[apart] / (angle[i] - angle[j])[apart])) if apart.any() else 0.0
    return float(np.median(log - slope * angle)), slope


def strengths_in_words(numbers: Sequence[int], gains: Gains) -> list[str]:
    """What is to be told of strengths."""
    wrong = np.flatnonzero(gains.wrong)
    if not len(wrong) and gains.spread > LEAST_GAIN and len(numbers) >= _ENOUGH:
        far = int(np.argmax(np.abs(np.log(gains.off))))
        return [
            f"The lights are not as strong as declared, by {gains.spread:.0%} in the mean (light {numbers[far]}: "
            f'{gains.off[far]:.2f} times): give light.intensity, or say intensities_are = "from the sphere" if matte.'
        ]
    if not len(wrong):
        return []
    worst = int(wrong[np.argmax(np.abs(np.log(gains.off[wrong])))])
    text = f"Light {numbers[worst]} is {gains.off[worst]:.2f} +- {gains.sd[worst]:.2f} times as strong as declared"
    if len(wrong) > 1:
        text += f", and {len(wrong) - 1} more of {len(numbers)} are not as strong as declared, either"
    return [f'{text}: give light.intensity, mend its exposure, or say intensities_are = "from the sphere" if matte.']
