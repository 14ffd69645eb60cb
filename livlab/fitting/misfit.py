"""Whether the tissue model describes the measured curves to the noise, and at which wavelengths it misses them.

The curves are compared as a likelihood would, whatever loss was minimised: e = f m − d, f the free factor where only
shapes are compared, with the covariance of d (its standard errors) and of f m (the walk's errors, which hang together
along the curve, and its interpolation). e is made independent by the symmetric root of that covariance, so that each
number keeps its wavelength, and goes to `livlab.optimise.misfit`.

Where no standard error is stated the noise is what neighbouring points differ by beyond a straight line
(`livlab.fitting.roughness`), less what the walk explains: a model that misses leaves residuals that are smooth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from livlab.fitting.problem import Problem
from livlab.fitting.roughness import SLOW, noise_of, ratio_p, slow_waves
from livlab.fitting.targets import CurveTarget
from livlab.optimise.misfit import CAVEAT, Misfit, chance, misfit, times
from livlab.optimise.structure import LIMIT, Grouping
from livlab.units import FloatArray

DOUBTFUL = 0.05
"""Chance below which a fit is called doubtful, and the intervals of a chi2 are widened."""

LEAST = 6
"""Degrees of freedom from which the noise can be told from the residuals themselves."""

FINEST = 1e-6
"""Share of a curve's level that its noise has at least: a measurement is not finer."""

REGIONS = (3, 8)
"""Points of a stretch of wavelengths at least, and stretches of a curve at most."""

STATED = "stated standard errors and the walk's own"
ESTIMATED = "estimated from how neighbouring points differ; a smoothed curve has more"
TOO_FEW = "no standard errors and too few points to estimate the noise"
NO_CURVE = "a colour is three numbers without a stated error"
NOTHING_LEFT = "no more numbers than free parameters"


@dataclass(frozen=True, eq=False)
class _Curves:
    """All curves of a fit as e = f m − d, end to end.

    Attributes
    ----------
    error
        (n,) e.
    place
        (n,) where on the model's curve.
    factor
        (n,) f.
    own
        (n, n) covariance of the data, 0 where it is not known.
    parts
        The curves: places in (n,), wavelengths (or numbers) of the points, label, whether the noise is known.
    free
        (k, n) what a free factor (and a free zero) of each curve adds.
    level
        Of the data: (n,).
    """

    error: FloatArray
    place: FloatArray
    factor: FloatArray
    own: FloatArray
    parts: tuple[tuple[slice, FloatArray, CurveTarget, bool], ...]
    free: FloatArray
    level: FloatArray

    @classmethod
    def of(cls, targets: Sequence[CurveTarget], model: FloatArray) -> _Curves | None:
        kept = [t for t in targets if t.loss != "colour"]
        if not kept:
            return None
        n = sum(t.size for t in kept)
        own, free, parts, pieces, begun = np.zeros((n, n)), [], [], [], 0
        for t in kept:
            at = slice(begun, begun + t.size)
            begun += t.size
            m, d, s = model[t.use], t.data[t.use], t.sigma[t.use]
            known = bool(np.all(np.isfinite(s) & (s > 0)))
            if known:
                own[at, at] = np.diag(s**2)
            if t.covariance is not None:
                own[at, at] += t.covariance[np.ix_(t.use, t.use)]
            rows = [m] if t.scaling != "none" or t.loss == "pearson" else []
            rows += [np.ones(t.size)] if t.loss == "pearson" else []
            weight = 1.0 / s if known else np.ones(t.size)
            by = np.linalg.lstsq((np.array(rows) * weight).T, d * weight, rcond=None)[0] if rows else np.ones(1)
            fitted = by @ np.array(rows) if rows else m
            for row in rows:
                free.append(np.zeros(n))
                free[-1][at] = row
            x = np.arange(t.size, dtype=np.float64) if t.wavelength_nm is None else t.wavelength_nm[t.use]
            parts.append((at, x, t, known))
            pieces.append((fitted - d, np.flatnonzero(t.use), np.full(t.size, by[0]), np.abs(d)))
        error, place, factor, level = (np.concatenate(p) for p in zip(*pieces, strict=True))
        return cls(error, place, factor, own, tuple(parts), np.array(free).reshape(-1, n), level)


def misfit_of(problem: Problem, at: Mapping[str, float], held: Sequence[str] = ()) -> Misfit:
    """By how much the model misses the measured curves at an optimum, beyond the noise; the walk's errors are noise.

    Parameters
    ----------
    problem
        Forward model, measured curves and parameters.
    at
        The optimum.
    held
        Parameters at a bound: they take nothing out of the residuals.
    """
    found = problem.answer(at, gradient=True)
    curves = _Curves.of(problem.targets, found.value)
    if curves is None:
        return _nothing(NO_CURVE)
    rows, priors = _directions(problem, at, curves, found.slopes, held)
    if curves.error.size + len(priors) <= np.linalg.matrix_rank(rows):
        return _nothing(NOTHING_LEFT)
    walk = _walk(problem, curves)
    known = all(part[3] for part in curves.parts)
    size = curves.error.size
    own = curves.own if known else _estimated(curves, walk, rows[:, :size])
    if own is None:
        return _nothing(TOO_FEW)
    white = _root(own + walk)
    z = np.concatenate([white @ curves.error, priors])
    jacobian = np.concatenate([rows[:, :size] @ white, rows[:, size:]], axis=1)
    told = misfit(
        z,
        jacobian,
        groups=_groups(curves, len(priors)),
        series=[np.arange(part[0].start, part[0].stop) for part in curves.parts],
        noise=STATED if known else ESTIMATED,
        relative=float(np.linalg.norm(curves.error) / max(float(np.linalg.norm(curves.level)), 1e-300)),
    )
    series = [(part[0], part[1]) for part in curves.parts]
    if known:
        return replace(told, structure=(*told.structure, slow_waves(z, jacobian, series)))
    return replace(told, p=ratio_p(z, jacobian, series))


def doubtful(found: Misfit) -> bool:
    """Whether a right model would look so in less than one case of twenty."""
    return min((p for p in (found.p, found.worst) if math.isfinite(p)), default=1.0) < DOUBTFUL


def widening(found: Misfit, by_residuals: bool) -> float:
    """What intervals from stated errors grow by where the model is doubtful, at least 1.

    √(χ²/dof), Birge's ratio (1932), or that of the residual's slow waves, which move the parameters, if it is larger.

    Parameters
    ----------
    by_residuals
        Whether the loss takes the noise from the residuals, which widens intervals already.
    """
    if by_residuals or not found.known or not doubtful(found):
        return 1.0
    slow = [s.ratio for s in found.structure if s.name == SLOW and math.isfinite(s.ratio)]
    return max(1.0, found.ratio, *slow)


def words(found: Misfit, widened: float, by_residuals: bool) -> str:
    """One sentence for readers: by how much the model misses, near which wavelength, and what the intervals are."""
    if not math.isfinite(found.chi2):
        return f"whether the model fits cannot be told: {found.noise}"
    grown = f"; the intervals are widened by {times(widened)} x" if widened > 1.0 else ""
    if found.told and by_residuals:
        grown = "; the intervals take all of the residual for noise"
    text = found.words
    if found.told:
        text = text.replace(f"; {CAVEAT}", f"{grown}, and hold only if the model is right" if grown else f"; {CAVEAT}")
    elif doubtful(found):
        least = min((s for s in found.structure if math.isfinite(s.p)), key=lambda s: s.p, default=None)
        on = f", its residuals hang on {least.name} ({chance(least.p)})" if least and least.p < found.p else ""
        text = f"it is doubtful that the model fits: {text.partition(': ')[2]}{on}{grown}; {CAVEAT}"
    return f"{text}; the noise is {ESTIMATED}" if found.noise == ESTIMATED else text


def _nothing(why: str) -> Misfit:
    return Misfit(math.nan, math.nan, math.nan, math.nan, why)


def _directions(
    problem: Problem, at: Mapping[str, float], curves: _Curves, slopes: Mapping[str, FloatArray], held: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    """(k, n + P) derivatives of e and of the priors' residuals by all that is free, and (P,) the priors' residuals."""
    free = problem.space.free
    known = [(p, p.prior_mean, p.prior_sd) for p in free if p.prior_mean is not None and p.prior_sd is not None]
    priors = np.array([(at[p.name] - mean) / sd for p, mean, sd in known], dtype=np.float64)
    rows = [np.concatenate([row, np.zeros(len(known))]) for row in curves.free]
    for p in free:
        if p.name in held or p.name not in slopes:
            continue
        total = np.array(slopes[p.name])
        for other in problem.space.parameters:
            if other.tied == p.name and other.name in slopes:
                total = total + other.factor * slopes[other.name]
        beside = [1.0 / sd if q.name == p.name else 0.0 for q, _, sd in known]
        rows.append(np.concatenate([curves.factor * total[curves.place], beside]))
    return np.array(rows).reshape(-1, curves.error.size + len(known)), priors


def _walk(problem: Problem, curves: _Curves) -> FloatArray:
    """(n, n) covariance of f m: the forward model's chance, and what its interpolation costs."""
    inside = np.ix_(curves.place, curves.place)
    made = np.zeros((len(curves.place), len(curves.place)))
    if problem.noise is not None:
        made += np.nan_to_num(problem.noise[inside])
    bias = getattr(problem.forward, "bias_covariance", None)
    if bias is not None:
        made += bias()[inside]
    return np.asarray(made * np.outer(curves.factor, curves.factor))


def _estimated(curves: _Curves, walk: FloatArray, rows: FloatArray) -> FloatArray | None:
    """The data's covariance with what neighbours show where nothing is stated; None where too few points are left."""
    made = curves.own.copy()
    basis = np.linalg.svd(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300))
    q = basis[2][: int(np.sum(basis[1] > 1e-6 * basis[1].max()))] if len(rows) else np.zeros((0, rows.shape[1]))
    project = np.eye(rows.shape[1]) - q.T @ q
    e = project @ curves.error
    for at, x, _, known in curves.parts:
        if known:
            continue
        if at.stop - at.start - len(q) < LEAST:
            return None
        inside = project[:, at]  # what the whole fit leaves of this curve
        floor = (FINEST * float(curves.level[at].max())) ** 2
        beside = walk + curves.own
        made[at, at] += np.diag(noise_of(e[at], x, curves.level[at], inside[at], inside.T @ beside @ inside, floor))
    return made


def _root(covariance: FloatArray) -> FloatArray:
    """The symmetric C^(−1/2): what it makes of a number is mostly that number's own."""
    eigen, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors / np.sqrt(np.maximum(eigen, 1e-14 * eigen[-1]))) @ vectors.T)


def _groups(curves: _Curves, priors: int) -> list[Grouping]:
    """Stretches of wavelengths of each curve, and the curves if there are several; priors are in none."""
    least, most = REGIONS
    index = np.full(curves.error.size + priors, -1, dtype=np.intp)
    labels: list[str] = []
    whose = index.copy()
    several = len(curves.parts) > 1
    for k, (at, x, t, _) in enumerate(curves.parts):
        whose[at] = k
        count = int(np.clip(len(x) // least, 1, most))
        for stretch in np.array_split(np.argsort(x), count):
            middle = f"{np.mean(x[stretch]):.4g} nm" if t.wavelength_nm is not None else f"point {stretch.mean():.0f}"
            index[at.start + stretch] = len(labels)
            labels.append(f"near {middle}{f' of {t.label}' if several else ''}")
    found = [Grouping("wavelength", index, tuple(labels))]
    if several:
        found.append(Grouping("measurement", whose, tuple(f"in {part[2].label}" for part in curves.parts)))
    return found


__all__ = ["LIMIT", "chance", "misfit_of", "widening", "words"]
