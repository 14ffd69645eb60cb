"""Whether the lights are what they were declared to be: places, strengths, and what slip explains it if not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.hypotheses import (
    ALIKE,
    FALSE_ALARM,
    SPOILS,
    Hypothesis,
    as_given,
    better,
    every_slip,
    threshold,
)
from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.shading import (
    Shading,
    SharedFit,
    Tilts,
    crossed,
    fit_shared,
    moved_to,
    patch_sums,
    terms,
    tilts,
)
from livlab.acquire.photographs.strengths import UNSAID, Gains, strengths, strengths_in_words

LEAST_ANGLE = float(np.deg2rad(3.0))
"""Angle by which a light may be off before it is told: it costs 7 % of a diffuse reflectance. Or the angle by which
one of the lights is off in a hundredth of such rigs, their directions being known to their sd, or to `UNSAID`."""

LEAST_TURN = float(np.deg2rad(1.5)), float(np.deg2rad(3.0))
"""The same for all lights turned as one: the first, and the second over the root of their number, since lights that
are known to 1 degree each turn by some of that together."""

LEAST_SCALE = 0.04
"""Relative error of a scale below which nothing is told."""

_LOOK = float(np.deg2rad(1.5))
_ROUGH = 0.03
_FALLS = 0.75
_FALLS_IF_FITTED = 0.6
"""A slip is named if the sum of squared residuals falls below this share; lower where it has a number to fit, which
follows a material as well as a fault."""

_FITTED = ("rotation", "scale", "near")
_TAKEN_UP = 1.3
_ORDER = ("flip", "axes", "order", "rotation", "scale", "near")


@dataclass(frozen=True, eq=False, repr=False)
class LightCheck:
    """What the pictures say about the lights.

    Attributes
    ----------
    kept
        Numbers of the pictures that could be judged; the arrays run over them.
    residual, residual_best
        Misfit of one isotropic reflectance as a share of the level, under the lights as given and under `best`.
    noise
        What the pixels' variance lets expect of it; NaN where the noise is not known.
    given, best
        The lights as given, and the slip that explains the pictures better; None where none does beyond the noise.
    also
        Slips that say the same for these lights.
    t, limit
        How much better `best` is, and what t has to pass (`livlab.acquire.photographs.hypotheses`).
    chance
        Bound on the chance of such a t where nothing is wrong.
    shading
        Where each picture puts its light.
    astray
        Whether each picture puts its light elsewhere than it is given, beyond its noise.
    each_residual
        (lights,) misfit of each picture under the lights as given.
    gains
        Strengths.
    warnings
        In words; the places' first.
    """

    kept: tuple[int, ...]
    residual: float
    residual_best: float
    noise: float
    given: Hypothesis
    best: Hypothesis | None
    also: tuple[Hypothesis, ...]
    t: float
    limit: float
    chance: float
    shading: Tilts
    astray: NDArray[np.bool_]
    each_residual: FloatArray
    gains: Gains
    warnings: tuple[str, ...]

    @property
    def misplaced(self) -> bool:
        """Whether the places of lights are in doubt."""
        return self.best is not None or bool(self.astray.any())

    @property
    def told(self) -> str:
        """The misfit in words."""
        text = f"residual {self.residual:.1%} of the level"
        if math.isfinite(self.noise) and self.noise > 0:
            text += f", {self.residual / self.noise:.2g} x the noise"
        return text

    def __repr__(self) -> str:
        said = " ".join(self.warnings) or "nothing speaks against the lights."
        return f"LightCheck({len(self.kept)} lights, {self.told}: {said})"


def judge(seen: Shading, sd_rad: Sequence[float] | None = None) -> LightCheck:
    """Judge the lights of some pictures.

    Parameters
    ----------
    seen
        Pixels of the pictures, with the lights as declared.
    sd_rad
        For each kept picture the standard uncertainty of its light's direction; 0 where it was not said.
    """
    sd = np.zeros(len(seen.lights)) if sd_rad is None else np.asarray(sd_rad, dtype=np.float64)
    given = as_given(seen)
    weights, good = _trusted(seen, given.fit)
    # The length of two tilts is Rayleigh's: P(> x sd) = exp(-x²/2) for each light.
    floor = np.maximum(LEAST_ANGLE, np.where(sd > 0, sd, UNSAID) * math.sqrt(2 * math.log(100 * len(sd))))
    found = tilts(seen, seen.lights, weights)
    crossing = crossed(seen, terms(seen, seen.placed(seen.lights)), weights)
    suspicious = (
        bool(np.any(found.angle_rad > _LOOK))
        or _share(seen, given.fit) > _ROUGH
        or bool(np.any(crossing.argmin(axis=1) != np.arange(len(crossing))))
        or not good.all()
    )
    limit = threshold(len(seen.lights))
    best, also = _winner(seen, given, every_slip(seen, given), sd) if suspicious else (None, ())
    t = better(seen, given.fit, best.fit)[0] if best is not None else 0.0
    if suspicious:
        found = _seen_anywhere(seen, found, weights if best is None else best.fit.weights)
    astray = _astray(seen, found, floor, weights) if best is None else _moved(seen, best, floor)
    now = given.fit if best is None else best.fit
    where = seen.lights if best is None else best.lights
    skip = astray if best is None else np.zeros(len(astray), dtype=bool)
    gains = strengths(seen, now, where, sd, skip)
    checked = LightCheck(
        kept=seen.kept,
        residual=_share(seen, given.fit),
        residual_best=_share(seen, now),
        noise=_noise(seen),
        given=given,
        best=best,
        also=also,
        t=t,
        limit=limit,
        chance=min(1.0, FALSE_ALARM * math.exp((limit**2 - t**2) / 2)),
        shading=found,
        astray=astray,
        each_residual=np.sqrt(given.fit.rss / np.maximum((seen.weight > 0).sum(axis=1), 1)),
        gains=gains,
        warnings=(),
    )
    return replace(checked, warnings=tuple(in_words(seen, checked)))


def _share(seen: Shading, fit: SharedFit) -> float:
    return math.sqrt(fit.total / max(int(np.count_nonzero(seen.weight)), 1))


def _noise(seen: Shading) -> float:
    known = (seen.weight > 0) & np.isfinite(seen.variance)
    if not known.any():
        return math.nan
    return math.sqrt(float(np.mean((seen.weight * np.nan_to_num(seen.variance))[known])))


def _trusted(seen: Shading, fit: SharedFit) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Weights of the reflectance from the pictures that agree with each other, and which these are."""
    good = np.ones(len(seen.lights), dtype=bool)
    if len(good) < 4:
        return fit.weights, good
    basis = terms(seen, seen.placed(seen.lights))
    weights = fit.weights
    for _ in range(4):
        rss = np.diagonal(crossed(seen, basis, weights)) / np.maximum((seen.weight > 0).sum(axis=1), 1)
        now = rss <= 4 * np.median(rss) + 1e-12
        if 2 * now.sum() < len(now) or np.array_equal(now, good):
            break
        good = now
        part = replace(
            seen,
            value=seen.value[good],
            weight=seen.weight[good],
            variance=seen.variance[good],
            lights=tuple(x for x, use in zip(seen.lights, good, strict=True) if use),
            kept=tuple(k for k, use in zip(seen.kept, good, strict=True) if use),
        )
        weights = fit_shared(part, basis[good]).weights
    return weights, good


def _winner(
    seen: Shading, given: Hypothesis, tried: Sequence[Hypothesis], sd: FloatArray
) -> tuple[Hypothesis | None, tuple[Hypothesis, ...]]:
    """The slip that explains the pictures beyond the noise and spoils none, and those that say the same."""
    limit = threshold(len(seen.lights))
    named = []
    for one in tried:
        t, each = better(seen, given.fit, one.fit)
        falls = _FALLS_IF_FITTED if one.kind in _FITTED else _FALLS
        small = (one.kind == "rotation" and one.amount < _least_turn(sd)) or (
            one.kind == "scale" and abs(math.log(one.amount)) < LEAST_SCALE
        )
        worse = one.fit.rss > 1.5 * given.fit.rss
        if small or t < limit or one.fit.total > falls * given.fit.total or bool(np.any((each < SPOILS) & worse)):
            continue
        named.append(one)
    if not named:
        return None, ()
    least = min(one.fit.total for one in named)
    alike = [one for one in named if one.fit.total <= (1 + ALIKE) * least or _same(seen, one, named, least)]
    # A number that is fitted takes up some of the lights' own uncertainty, too: that does not make it likelier.
    if all(one.kind in _FITTED for one in alike):
        alike += [one for one in named if one.kind not in _FITTED and one.fit.total <= _TAKEN_UP * least]
    alike.sort(key=lambda one: (_ORDER.index(one.kind), one.fit.total))
    return alike[0], tuple(alike[1:])


def _least_turn(sd: FloatArray) -> float:
    return max(LEAST_TURN[0] + LEAST_TURN[1] / math.sqrt(len(sd)), 3 * float(np.median(sd)))


def _same(seen: Shading, one: Hypothesis, named: Sequence[Hypothesis], least: float) -> bool:
    """Whether a slip leaves what the best one leaves, by the noise."""
    best = next(h for h in named if h.fit.total == least)
    t, _ = better(seen, one.fit, best.fit)
    return t < 2 and one.fit.total <= 1.2 * least


def _moved(seen: Shading, best: Hypothesis, floor: FloatArray) -> NDArray[np.bool_]:
    turned = np.einsum("ki,ki->k", seen.directions(best.lights), seen.directions(seen.lights))
    moved = np.arccos(np.clip(turned, -1, 1)) > min(float(floor.min()), LEAST_TURN[0])
    return np.asarray(moved)


def _sky(seen: Shading, count: int = 160) -> FloatArray:
    """Directions (n, 3) spread evenly over what may light a sphere in view: to 125 degrees from the eye."""
    k = np.arange(count) + 0.5
    z = 1 - k / count * (1 - math.cos(math.radians(125)))
    phi = math.pi * (1 + math.sqrt(5)) * k
    s = np.sqrt(np.clip(1 - z**2, 0, None))
    eye = -seen.camera.axis
    across = np.cross(eye, [0.0, 1.0, 0.0] if abs(eye[1]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    basis = np.stack([across, np.cross(eye, across), eye])
    return np.asarray(np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1) @ basis)


def _seen_anywhere(seen: Shading, found: Tilts, weights: FloatArray) -> Tilts:
    """Where the pictures put their lights if these may be anywhere: the best of a net of directions, then refined."""
    sky = _sky(seen)
    lamp = seen.lights[0]
    net = [moved_to(lamp, d, seen.centre_mm) for d in sky]
    cost = crossed(seen, terms(seen, seen.placed(net)), weights)
    here = np.diagonal(crossed(seen, terms(seen, seen.placed(seen.lights)), weights))
    start = [
        moved_to(light, sky[int(np.argmin(cost[k]))], seen.centre_mm) if cost[k].min() < 0.8 * here[k] else light
        for k, light in enumerate(seen.lights)
    ]
    again = tilts(seen, start, weights, rounds=8)
    told = seen.directions(seen.lights)
    angle = np.arccos(np.clip(np.einsum("ki,ki->k", again.direction, told), -1, 1))
    return replace(again, angle_rad=angle, z=angle / np.maximum(again.sd_rad, 1e-6))


def _astray(seen: Shading, found: Tilts, floor: FloatArray, weights: FloatArray) -> NDArray[np.bool_]:
    """Pictures that are better explained by a light elsewhere, beyond the noise."""
    there = [moved_to(x, d, seen.centre_mm) for x, d in zip(seen.lights, found.direction, strict=True)]
    root = np.sqrt(seen.weight)
    sums = []
    for lights in (seen.lights, there):
        made = terms(seen, seen.placed(lights)) @ weights
        power = np.maximum(np.einsum("kp,kp->k", seen.weight, made**2), 1e-300)
        gain = np.clip(np.einsum("kp,kp->k", seen.weight * seen.value, made) / power, 0, None)
        sums.append(patch_sums(seen, ((seen.value - gain[:, None] * made) * root) ** 2))
    one, two = sums
    fall = (one - two) / (one + two + float(np.median(np.minimum(one, two))) + 1e-300)
    t = fall.sum(axis=1) / np.sqrt((fall**2).sum(axis=1) + 1e-12)
    limit = math.sqrt(2 * math.log(len(one) / FALSE_ALARM))
    halved = two.sum(axis=1) < _FALLS_IF_FITTED * one.sum(axis=1)
    # A small sphere has few patches: what is far off is told by its own error.
    plain = (found.z > 6) & (found.angle_rad > 3 * floor)
    return np.asarray((found.angle_rad > floor) & halved & ((t > limit) | plain))


def in_words(seen: Shading, found: LightCheck) -> list[str]:
    """What is to be told."""
    said = []
    numbers = seen.kept
    wrong = np.flatnonzero(found.astray)
    count = len(numbers)
    if found.best is not None:
        turned = np.einsum("ki,ki->k", seen.directions(found.best.lights), seen.directions(seen.lights))
        angle = np.arccos(np.clip(turned, -1, 1))
        fits = f"they fit with {found.best.words}"
        if found.also:
            fits += f" (or, which is the same for these lights, {found.also[0].words})"
        spoilt = "; no picture fits worse" if len(wrong) < count else ""
        fits += (
            f". One reflectance then misses the pictures by {found.residual_best:.1%} instead of {found.residual:.1%}"
            f"{spoilt} (chance of that by noise < {max(found.chance, 1e-9):.1g})."
        )
        if len(wrong):
            worst = int(np.argmax(angle))
            said.append(_elsewhere(len(wrong), count, numbers[worst], angle[worst]) + fits)
        else:
            said.append(f"The pictures do not show the distances that the lights are given: {fits}")
    elif len(wrong):
        worst = int(wrong[np.argmax(found.shading.angle_rad[wrong])])
        text = _elsewhere(len(wrong), count, numbers[worst], found.shading.angle_rad[worst])
        if 2 * len(wrong) < count or count == 1:
            text += f"check the entries of light {_listed([numbers[k] for k in wrong])}."
        else:
            text += "check the frame, signs, units and order of the directions. No single slip explains them."
        said.append(text)
    elif found.residual > 0.15 and not found.residual < 5 * found.noise:
        said.append(
            f"No one reflectance explains the pictures under these lights: {found.told}. A second light, cast shadows, "
            "a surface that differs from place to place, or values that are not linear would look like that."
        )
    return said + strengths_in_words(numbers, found.gains)


def _elsewhere(wrong: int, count: int, number: int, angle: float) -> str:
    return (
        f"{wrong} of {count} pictures look lit from elsewhere than their lights' directions say "
        f"(light {number} by {np.rad2deg(angle):.0f} degrees): "
    )


def _listed(numbers: Sequence[int], most: int = 6) -> str:
    shown = [str(k) for k in numbers[:most]]
    more = f" and {len(numbers) - most} more" if len(numbers) > most else ""
    return (
        ", ".join(shown[:-1])
        + (" and " if len(shown) > 1 and not more else ", " if len(shown) > 1 else "")
        + shown[-1]
        + more
    )
