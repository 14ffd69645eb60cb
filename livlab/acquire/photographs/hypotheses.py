"""Slips that may have happened to the lights' places: each is tried on all pictures, and the misfits are compared.

Two hypotheses are compared patch by patch. With R₁ and R₂ a patch's sums of squared residuals under the two, and s the
median of the smaller ones, d = (R₁ − R₂) / (R₁ + R₂ + s) and t = Σ d / √(Σ d²). Where the first hypothesis is right,
the d of a fixed second one have no reason to be positive, and P(t > x) ≤ exp(−x²/2) for independent d of symmetric
distribution, however unlike their sizes are (Efron 1969). So a slip is named only where t is above √(2 ln(m / α)), of m
hypotheses that are tried.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from livlab.acquire.photographs.outline import FloatArray
from livlab.acquire.photographs.shading import (
    Shading,
    SharedFit,
    crossed,
    fit_shared,
    moved_to,
    patch_sums,
    terms,
)
from livlab.brdf.geometry import Light

FALSE_ALARM = 1e-3
"""Bound on the chance that any slip is named where none happened, as far as patches err independently."""

SPOILS = -3.0
"""t of a single picture below which a hypothesis makes it worse: then acting on it would spoil that light."""

ALIKE = 0.02
"""Relative difference of total misfit within which two hypotheses say the same."""

_FLIPS: dict[tuple[int, ...], str] = {
    (1, -1, -1): 'the other frame (frame = "photometric-stereo" or "camera")',
    (1, -1, 1): "up and down exchanged",
    (-1, 1, 1): "left and right exchanged",
    (-1, -1, -1): "directions that lead from the light to the sphere",
    (-1, -1, 1): "a half turn about the camera's axis (x and y with the other sign)",
    (1, 1, -1): "the sign of z changed",
    (-1, 1, -1): "the signs of x and z changed",
}


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What may have happened to the lights' places, tried.

    Attributes
    ----------
    kind
        "as given", "flip", "axes", "order", "rotation", "scale" or "near".
    words
        What it is, to stand after "they fit with".
    lights
        Where the lights then are.
    fit
        The shared reflectance under them.
    order
        For each picture the number of the light whose place it takes; empty but for kind "order".
    amount
        Angle (rad) of a rotation, factor of a scale, distance (mm) of near lights.
    """

    kind: str
    words: str
    lights: tuple[Light, ...]
    fit: SharedFit
    order: tuple[int, ...] = ()
    amount: float = 0.0


def better(seen: Shading, first: SharedFit, second: SharedFit) -> tuple[float, FloatArray]:
    """How much better the second fit is: t over all patches, and (pictures,) over those of each."""
    one, two = patch_sums(seen, first.residual**2), patch_sums(seen, second.residual**2)
    level = float(np.median(np.minimum(one, two)))
    # Differences far below the misfit itself are rounding.
    fall = np.where(np.abs(one - two) > 1e-6 * (one + two), one - two, 0.0) / (one + two + level + 1e-300)
    whole = float(fall.sum() / math.sqrt(float((fall**2).sum()) + 1e-12))
    each = fall.sum(axis=1) / np.sqrt((fall**2).sum(axis=1) + 1e-12)
    return whole, np.asarray(each)


def threshold(lights: int, chance: float = FALSE_ALARM) -> float:
    """The t above which a hypothesis is named, with so many lights."""
    tried = 60 + lights * (lights - 1) / 2
    return math.sqrt(2 * math.log(tried / chance))


def as_given(seen: Shading) -> Hypothesis:
    """The lights as they were declared."""
    return Hypothesis("as given", "the lights as given", seen.lights, _fit(seen, seen.lights))


def _fit(seen: Shading, lights: Sequence[Light]) -> SharedFit:
    return fit_shared(seen, terms(seen, seen.placed(lights)))


def every_slip(seen: Shading, given: Hypothesis) -> list[Hypothesis]:
    """All hypotheses but "as given", each at its best."""
    found = signed_axes(seen)
    best = min(found, key=lambda h: h.fit.total)
    found += orders(seen, [given.fit.weights, best.fit.weights])
    found += [rotation(seen, given)]
    if all(light.near for light in seen.lights):
        found += [scaled(seen, given)]
    elif not any(light.near for light in seen.lights):
        found += [nearer(seen, given)]
    return found


def signed_axes(seen: Shading) -> list[Hypothesis]:
    """Every change of signs and exchange of axes, in the frame x right, y up, z to the camera."""
    coarse = _thinned(seen, 160)
    tried = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            if order == (0, 1, 2) and signs == (1, 1, 1):
                continue
            matrix = np.diag(signs).astype(float)[:, list(order)]
            lights = _transformed(seen, matrix)
            if lights is None:
                continue
            tried.append((_fit(coarse, lights).total, order, signs, lights))
    tried.sort(key=lambda one: one[0])
    # All flips, and of the exchanges those that may be the best.
    chosen = [one for one in tried if one[1] == (0, 1, 2)] + [one for one in tried[:4] if one[1] != (0, 1, 2)]
    return [
        Hypothesis("flip" if order == (0, 1, 2) else "axes", _axes_in_words(order, signs), lights, _fit(seen, lights))
        for _, order, signs, lights in chosen
    ]


def _thinned(seen: Shading, most: int) -> Shading:
    step = max(len(seen.normals) // most, 1)
    part = slice(None, None, step)
    return replace(
        seen,
        points_mm=seen.points_mm[part],
        normals=seen.normals[part],
        eye=seen.eye[part],
        value=seen.value[:, part],
        variance=seen.variance[:, part],
        weight=seen.weight[:, part],
        patch=seen.patch[part],
    )


def _transformed(seen: Shading, matrix: FloatArray) -> tuple[Light, ...] | None:
    """Lights whose numbers were changed by a matrix in the frame x right, y up, z to the camera; None if not placed."""
    turn = np.diag([1.0, -1.0, -1.0]) @ seen.camera.rotation
    whole = turn.T @ matrix @ turn
    found = []
    for light in seen.lights:
        if light.position_mm is None:
            found.append(moved_to(light, whole @ light.at(seen.centre_mm)[0], seen.centre_mm))
            continue
        at = whole @ light.position_mm
        if float(np.linalg.norm(at - seen.centre_mm)) <= 1.02 * seen.sphere.radius_mm:
            return None
        found.append(Light(light.intensity, None, at, light.solid_angle_sr))
    return tuple(found)


def _axes_in_words(order: tuple[int, ...], signs: tuple[int, ...]) -> str:
    if order == (0, 1, 2):
        return _FLIPS[signs]
    frame = ""
    # In the camera's frame, where y and z have the other sign, the same may be a plain exchange.
    turn = (1, -1, -1)
    other = tuple(turn[k] * signs[k] * turn[order[k]] for k in range(3))
    if sum(sign < 0 for sign in other) < sum(sign < 0 for sign in signs):
        signs, frame = other, " (in the camera's frame)"
    swapped: dict[tuple[int, ...], str] = {
        (1, 0, 2): "x and y exchanged",
        (2, 1, 0): "x and z exchanged",
        (0, 2, 1): "y and z exchanged",
    }
    text = swapped.get(order, f"the axes in the order {', '.join('xyz'[k] for k in order)}")
    changed = [name for name, sign in zip("xyz", signs, strict=True) if sign < 0]
    return text + (f" and the sign of {' and '.join(changed)} then changed" if changed else "") + frame


def orders(seen: Shading, weights: Sequence[FloatArray]) -> list[Hypothesis]:
    """The best other order of the lights: nearest assignment under a reflectance, which is then fitted again.

    Begun from several reflectances, and from orders that are shifted and reversed as wholes.
    """
    count = len(seen.lights)
    same = tuple(range(count))
    coarse = _thinned(seen, 160)
    part = terms(coarse, coarse.placed(seen.lights))
    plain = [np.zeros(part.shape[2]) for _ in range(4)]
    for k, start in enumerate(plain):
        start[1] = 1.0
        if k:
            start[4 + 2 * k - (k > 1)] = 0.3
    best, least = same, math.inf
    for start in (*weights, *plain):
        order, total = _assigned(coarse, part, start)
        if total < least:
            best, least = order, total
    for by, turned in itertools.product(range(count), (1, -1)):
        whole = tuple((turned * k + by) % count for k in same)
        fit = fit_shared(coarse, part[list(whole)])
        if whole != same and fit.total < least:
            best, least = _assigned(coarse, part, fit.weights)
    if best == same:
        return []
    basis = terms(seen, seen.placed(seen.lights))
    found = {_pruned(seen, basis, best)} - {same}
    if _whole(best):
        found.add(best)  # a shift or a reversal moves all of them, also those of which that alone would not be told
    tried = []
    for order in sorted(found):
        moved = tuple(_of(seen.lights[j], seen.lights[k]) for k, j in enumerate(order))
        fit = fit_shared(seen, basis[list(order)])
        tried.append(Hypothesis("order", order_in_words(order, seen.kept), moved, fit, order))
    return tried


def _whole(order: Sequence[int]) -> bool:
    """Whether an order is a shift or a reversal of all."""
    count = len(order)
    return count > 2 and any(len({(order[k] - sign * k) % count for k in range(count)}) == 1 for sign in (1, -1))


def _assigned(seen: Shading, basis: FloatArray, weights: FloatArray) -> tuple[tuple[int, ...], float]:
    """Order and misfit that assignment and fit in turn lead to."""
    from scipy.optimize import linear_sum_assignment

    best: tuple[int, ...] = tuple(range(len(basis)))
    least, last = math.inf, None
    for _ in range(8):
        _, columns = linear_sum_assignment(crossed(seen, basis, weights))
        order = tuple(int(j) for j in columns)
        if order == last:
            break
        last = order
        fit = fit_shared(seen, basis[list(order)])
        weights = fit.weights
        if fit.total < least:
            best, least = order, fit.total
    return best, least


def _of(place: Light, strength: Light) -> Light:
    return replace(place, intensity=strength.intensity)


def _pruned(seen: Shading, basis: FloatArray, order: tuple[int, ...]) -> tuple[int, ...]:
    """The order without those of its cycles that do not better the misfit by more than the noise."""
    kept = list(order)
    limit = threshold(len(order))
    for cycle in cycles(order):
        without = list(kept)
        for k in cycle:
            without[k] = k
        t, _ = better(seen, fit_shared(seen, basis[without]), fit_shared(seen, basis[kept]))
        if t < limit:
            kept = without
    return tuple(kept)


def cycles(order: Sequence[int]) -> list[list[int]]:
    """The cycles of a permutation that move something."""
    found, seen = [], set[int]()
    for start in range(len(order)):
        cycle, k = [], start
        while k not in seen:
            seen.add(k)
            cycle.append(k)
            k = order[k]
        if len(cycle) > 1:
            found.append(cycle)
    return found


def order_in_words(order: Sequence[int], numbers: Sequence[int]) -> str:
    """A permutation as its reader would have made it."""
    count = len(order)
    moved = [k for k in range(count) if order[k] != k]
    shown = ", ".join(f"the direction of light {numbers[order[k]]} fits picture {numbers[k]}" for k in moved[:3])
    shown += ", …" if len(moved) > 3 else ""
    shifts = {(order[k] - k) % count for k in range(count)}
    if len(moved) == 2:
        return f"lights {numbers[moved[0]]} and {numbers[moved[1]]} exchanged ({shown})"
    if len(shifts) == 1 and count > 2:
        by = shifts.pop()
        by = by if by <= count // 2 else by - count
        return f"the lights in another order, shifted by {abs(by)} ({shown})"
    if _whole(order):
        return f"the lights in another order, reversed ({shown})"
    return f"the lights in another order ({shown})"


def rotation(seen: Shading, given: Hypothesis) -> Hypothesis:
    """All lights turned by one rotation about the sphere, as a turned camera would have it."""
    from scipy.spatial.transform import Rotation

    directions = seen.directions(seen.lights)

    def turned(vector: FloatArray) -> list[Light]:
        matrix = Rotation.from_rotvec(vector).as_matrix()
        return [moved_to(light, matrix @ d, seen.centre_mm) for light, d in zip(seen.lights, directions, strict=True)]

    axis = -seen.camera.axis
    # Rolls of the camera are tried from all round; tilts begin at none.
    coarse = _thinned(seen, 160)
    rolls = np.deg2rad([0, 30, 60, 90, 120, 150, 180, -30, -60, -90, -120, -150])
    costs = [_fit(coarse, turned(angle * axis)).total for angle in rolls]
    start = float(rolls[int(np.argmin(costs))]) * axis
    vector = Rotation.from_rotvec(_descend(seen, turned, start)).as_rotvec()  # at most half a turn
    lights = tuple(turned(vector))
    angle = float(np.linalg.norm(vector))
    about = vector @ seen.camera.rotation.T / max(angle, 1e-12)
    along = abs(float(about[2]))
    how = "about the camera's axis" if along > 0.9 else f"about ({about[0]:.2f}, {-about[1]:.2f}, {-about[2]:.2f})"
    words = f"all of them turned by {np.rad2deg(angle):.1f} degrees {how}"
    return Hypothesis("rotation", words, lights, _fit(seen, lights), amount=angle)


def _descend(seen: Shading, lights_of: Callable[[FloatArray], list[Light]], start: FloatArray) -> FloatArray:
    """Least squares over the parameters of a hypothesis, reflectance and gains fitted at each step."""
    from scipy.optimize import least_squares

    part = _thinned(seen, 400)

    def residual(x: FloatArray) -> FloatArray:
        return np.asarray(_fit(part, lights_of(x)).residual.ravel())

    found = least_squares(
        residual, start, method="trf", diff_step=[1e-3] * len(start), x_scale=0.1, max_nfev=15, ftol=1e-6
    )
    return np.asarray(found.x)


def scaled(seen: Shading, given: Hypothesis) -> Hypothesis:
    """Near lights whose distances do not fit the sphere's size: its radius, the focal length, or their unit."""
    eye = seen.camera.centre_mm

    def at(x: FloatArray) -> list[Light]:
        by = float(np.exp(x[0]))
        return [
            replace(light, position_mm=eye + (light.position_mm - eye) / by)
            for light in seen.lights
            if light.position_mm is not None
        ]

    def clear(x: float) -> bool:
        lights = at(np.array([x]))
        far = [float(np.linalg.norm(light.position_mm - seen.centre_mm)) for light in lights]  # type: ignore[operator]
        return min(far) > 1.1 * seen.sphere.radius_mm

    coarse = _thinned(seen, 160)
    tried = [x for x in np.log([1.0, 0.1, 0.5, 0.8, 1.25, 2.0, 10.0]) if clear(x)]
    start = min(tried, key=lambda x: _fit(coarse, at(np.array([x]))).total)
    x = _descend(seen, lambda v: at(v) if clear(float(v[0])) else at(np.array([start])), np.array([start]))
    lights = tuple(at(x))
    by = float(np.exp(x[0]))
    words = (
        f"a sphere {by:.3g} times as large and as far away: sphere.radius_mm = {seen.sphere.radius_mm * by:.4g} in "
        f"place of {seen.sphere.radius_mm:.4g}, or positions {1 / by:.3g} times those given"
    )
    return Hypothesis("scale", words, lights, _fit(seen, lights), amount=by)


def nearer(seen: Shading, given: Hypothesis) -> Hypothesis:
    """Lights that were taken as distant and stand near, all as far away as each other."""
    directions = seen.directions(seen.lights)
    radius = seen.sphere.radius_mm

    def at(x: FloatArray) -> list[Light]:
        far = radius / float(np.clip(x[0], 1e-4, 0.7))
        return [
            Light(light.intensity * far**2, None, seen.centre_mm + far * d, light.solid_angle_sr)
            for light, d in zip(seen.lights, directions, strict=True)
        ]

    coarse = _thinned(seen, 160)
    start = min((0.003, 0.02, 0.05, 0.1, 0.2, 0.35), key=lambda x: _fit(coarse, at(np.array([x]))).total)
    x = float(np.clip(_descend(seen, at, np.array([start]))[0], 1e-4, 0.7))
    lights = tuple(at(np.array([x])))
    words = f"near lights, {radius / x:.3g} mm from the sphere's centre ({1 / x:.2g} of its radii), not distant ones"
    return Hypothesis("near", words, lights, _fit(seen, lights), amount=radius / x)
