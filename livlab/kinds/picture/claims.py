"""Claims of a picture experiment: colours of the lit body held against bounds, with their errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from livlab.criteria import Claim
from livlab.kinds.picture.colour import MeanColour, propagated
from livlab.kinds.picture.config import PictureCriterion, PictureExperiment
from livlab.model.colour import delta_e_2000, lab
from livlab.units import FloatArray

Key = tuple[str, str]
"""A picture: name of the tissue ("" for the experiment's own), name of the reading."""

_COORDINATES = {"lightness": "L", "redness": "a", "yellowness": "b", "hue": "hue", "chroma": "chroma"}


@dataclass(frozen=True)
class PictureSummary:
    """What claims are made of: one picture's mean colours by route, and what it cost."""

    colours: Mapping[str, MeanColour]
    relative_error: float
    seconds: float
    memory_gib: float
    samples_per_second: float = float("nan")


def judge(config: PictureExperiment, pictures: Mapping[Key, PictureSummary]) -> list[Claim]:
    """Every claim of an experiment.

    Parameters
    ----------
    config
        The experiment.
    pictures
        What was seen, by tissue and reading.
    """
    claims = []
    for c, reading, name in config.claims():
        own = pictures[(c.of or "", reading)]
        try:
            value, error = _value(config, c, own, pictures, reading)
        except ArithmeticError as reason:
            claims.append(Claim.missing(name, str(reason), aim=c.aim, seconds=own.seconds))
            continue
        if not (np.isfinite(value) and np.isfinite(error)):
            why = "the picture gives no number: nothing of the body is lit"
            claims.append(Claim.missing(name, why, aim=c.aim, seconds=own.seconds))
            continue
        claims.append(Claim.judged(name, value, error, c.aim, seconds=own.seconds))
    return claims


def _value(
    config: PictureExperiment,
    c: PictureCriterion,
    own: PictureSummary,
    pictures: Mapping[Key, PictureSummary],
    reading: str,
) -> tuple[float, float]:
    if c.metric == "relative error":
        return own.relative_error, 0.0
    if c.metric == "seconds":
        return own.seconds, 0.0
    if c.metric == "speed":
        return own.samples_per_second, 0.0
    if c.metric == "memory":
        return own.memory_gib, 0.0
    route = c.route or config.colour.routes[0]
    colour = own.colours[route]
    if c.metric == "colour difference":
        return _difference(colour, own.colours[str(c.against)])
    what = _COORDINATES[c.metric.removesuffix(" difference")]
    value, error = colour.uncertain(what)
    if not c.metric.endswith("difference"):
        return value, error
    other, other_error = pictures[(str(c.against), reading)].colours[route].uncertain(what)
    change = value - other
    if what == "hue":
        change = (change + 180.0) % 360.0 - 180.0
    return change, float(np.hypot(error, other_error))


def _difference(first: MeanColour, second: MeanColour) -> tuple[float, float]:
    """ΔE00 of two routes on one picture: one spectrum, so that their errors go together as it says."""

    def between(spectrum: FloatArray) -> float:
        pair = [xr.DataArray(lab(x.weights @ spectrum), dims="channel") for x in (first, second)]
        return float(delta_e_2000(pair[0], pair[1], space="lab"))

    return between(first.spectrum), propagated(between, first.spectrum, first.covariance)
