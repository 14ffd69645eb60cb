"""Covariance of fitted parameters from the objective's curvature or the residuals' Jacobian."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.optimise.guard import Objective
from livlab.optimise.parameters import AT_BOUND, Parameter, ParameterSpace
from livlab.units import FloatArray

SINGULAR = 1e-12
"""Share of the largest eigenvalue of the scaled information below which a direction counts as not measured at all."""


TOLD_APART = 0.01
"""Share of its standard deviation by which a parameter is off a bound that lies within a hair."""


@dataclass(frozen=True, eq=False)
class Covariance:
    """Second moments of the free parameters about the optimum.

    Attributes
    ----------
    matrix
        Covariance in the parameters' own units, a frame by names.
    correlation
        The same with unit diagonal.
    sd
        Standard deviation by name, tied parameters included; infinite along what the data do not measure.
    held
        Parameters left out since they sit at a bound, where a curvature says nothing.
    information
        2 × one_sigma⁻¹-scaled curvature in the transformed parameters t (p, ln p, log-odds), a frame by names.
    transformed_sd
        Standard deviation of t by name.
    values, space
        Where it was taken, and the parameters.
    """

    matrix: pd.DataFrame
    correlation: pd.DataFrame
    sd: dict[str, float]
    held: tuple[str, ...]
    information: pd.DataFrame
    transformed_sd: dict[str, float]
    values: dict[str, float]
    space: ParameterSpace

    def intervals(self, level: float = 0.6827) -> pd.DataFrame:
        """Normal intervals in the transformed parameters, mapped back: lower, value, upper by name.

        Raises
        ------
        InputError
            A level outside (0, 1).
        """
        z = normal_quantile(level)
        rows = {}
        for name in self.matrix.index:
            p, value, sd = self.space.by_name[name], self.values[name], self.transformed_sd[name]
            t = p.inward(value)
            low = p.outward(t - z * sd) if math.isfinite(sd) else p.low
            high = p.outward(t + z * sd) if math.isfinite(sd) else p.high
            rows[name] = {"lower": low, "value": value, "upper": high}
        frame = pd.DataFrame.from_dict(rows, orient="index", columns=["lower", "value", "upper"])
        frame.index.name = "parameter"
        return frame


def normal_quantile(level: float) -> float:
    """Half-width in standard deviations of a central normal interval.

    >>> round(normal_quantile(0.95), 3)
    1.96
    """
    from scipy.special import ndtri

    if not 0 < level < 1:
        raise InputError.of("level", level, "must lie between 0 and 1", "Use 0.6827 for one standard deviation.")
    return float(ndtri(0.5 + 0.5 * level))


def covariance(
    objective: Objective,
    parameters: Sequence[Parameter] | ParameterSpace,
    best: Mapping[str, float],
    *,
    one_sigma: float = 0.5,
) -> Covariance:
    """Covariance 2 one_sigma H⁻¹ from the Hessian H of the objective at its minimum, by central differences.

    Each step is chosen so that the objective rises by about a tenth of `one_sigma` (as James & Roos 1975 do), which
    keeps rounding and noise of the objective out and the quadratic in.

    Parameters
    ----------
    objective, parameters, one_sigma
        As given to `minimise`; priors are added here as there.
    best
        `OptimiseResult.best`.

    Raises
    ------
    InputError
        The objective is not finite at `best`.
    """
    space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
    x = space.vector(best)

    def value(at: FloatArray) -> float:
        values = space.values(at)
        return float(objective(values)) + 2.0 * one_sigma * space.prior(values)

    centre = value(x)
    if not math.isfinite(centre):
        raise InputError.of("best", dict(best), "the objective is not finite there", "Give the minimum found.")

    def told_apart(k: int, bound: float) -> bool:
        moved = x.copy()
        moved[k] = bound
        return bool(value(moved) - centre > TOLD_APART**2 * one_sigma)

    keep = _inside(space, x, told_apart)
    steps = np.array([_step(value, x, k, space, centre, one_sigma) for k in keep])
    hessian = np.zeros((len(keep), len(keep)))
    for a, i in enumerate(keep):
        for b, j in enumerate(keep[: a + 1]):
            hessian[a, b] = hessian[b, a] = _second(value, x, i, j, steps[a], steps[b], centre)
    return from_information(space, x, hessian / (2.0 * one_sigma), keep)


def covariance_of_residuals(
    jacobian: Mapping[str, FloatArray],
    parameters: Sequence[Parameter] | ParameterSpace,
    best: Mapping[str, float],
    *,
    variance: float = 1.0,
    scatter: Mapping[tuple[str, str], float] | None = None,
) -> Covariance:
    """Covariance of least squares, variance × (JᵀJ)⁻¹, or with `scatter` the sandwich (JᵀJ)⁻¹ S (JᵀJ)⁻¹.

    Parameters
    ----------
    jacobian
        Derivative of the (n,) residuals by each parameter, in its own unit.
    best
        Where it was taken.
    variance
        Of one residual.
    scatter
        S by pairs of names: the covariance of Jᵀr over independent blocks, where residuals hang together
        (Huber 1967; White 1980).
    """
    space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)
    x = space.vector(best)
    whole, slopes = space.columns(x, jacobian).T, space.slopes(x)

    def told_apart(k: int, bound: float) -> bool:
        return bool(abs(x[k] - bound) * float(np.linalg.norm(whole[k])) > TOLD_APART * math.sqrt(variance))

    keep = _inside(space, x, told_apart)
    matrix = whole[keep] if keep else np.zeros((0, 0))  # every one is at a bound
    normal = matrix @ matrix.T
    for row, k in enumerate(keep):
        sd = space.free[k].prior_sd
        normal[row, row] += variance * (slopes[k] / sd) ** 2 if sd is not None else 0.0
    spread = None
    if scatter is not None:
        names = [space.names[k] for k in keep]
        d = slopes[keep]
        spread = np.array([[scatter[a, b] for b in names] for a in names]) * np.outer(d, d)
    return from_information(space, x, normal / variance, keep, None if spread is None else spread / variance**2)


def from_information(
    space: ParameterSpace, x: FloatArray, information: FloatArray, keep: list[int], spread: FloatArray | None = None
) -> Covariance:
    """The record from an information matrix in the scaled parameters of `space`."""
    names = [space.names[k] for k in keep]
    inverse, lost = _inverse(information)
    moments = inverse if spread is None else inverse @ spread @ inverse
    slopes, units = space.slopes(x)[keep], space.unit[keep]
    with np.errstate(invalid="ignore", divide="ignore"):
        matrix = moments * np.outer(slopes, slopes)
        sd = np.sqrt(np.where(np.diag(matrix) >= 0, np.diag(matrix), np.nan))
        correlation = matrix / np.outer(sd, sd)
    transformed = np.sqrt(np.maximum(np.diag(moments), 0.0)) * units
    sd, transformed = np.where(lost, np.inf, sd), np.where(lost, np.inf, transformed)
    sds = {name: float(s) for name, s in zip(names, sd, strict=True)}
    for p in space.parameters:
        if p.tied in sds:
            sds[p.name] = abs(p.factor) * sds[p.tied]

    def framed(array: FloatArray) -> pd.DataFrame:
        return pd.DataFrame(array, index=names, columns=names)

    return Covariance(
        matrix=framed(matrix),
        correlation=framed(correlation),
        sd=sds,
        held=tuple(n for k, n in enumerate(space.names) if k not in keep),
        information=framed(information / np.outer(units, units)),
        transformed_sd={name: float(s) for name, s in zip(names, transformed, strict=True)},
        values=space.values(x),
        space=space,
    )


def _inverse(information: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Inverse on what is measured, and which parameters reach into what is not."""
    if information.size == 0:
        return information, np.zeros(0, dtype=bool)
    scale = np.sqrt(np.abs(np.diag(information)))
    scale = np.where(scale > 0, scale, 1.0)
    eigen, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    bad = eigen <= SINGULAR * max(float(eigen.max()), 0.0)
    lost = np.any(np.abs(vectors[:, bad]) > 0.05, axis=1)
    good = ~bad
    inverse = (vectors[:, good] / eigen[good]) @ vectors[:, good].T
    return inverse / np.outer(scale, scale), lost


def _inside(space: ParameterSpace, x: FloatArray, told_apart: Callable[[int, float], bool]) -> list[int]:
    """Parameters that are at no bound: far from it, or near but told apart from it by the objective."""
    width = np.where(np.isfinite(space.high - space.low), space.high - space.low, 1.0)
    kept = []
    for k in range(x.size):
        bound = float(space.low[k] if x[k] - space.low[k] <= space.high[k] - x[k] else space.high[k])
        room = abs(x[k] - bound)
        if room > AT_BOUND * width[k] or (room > 0.0 and told_apart(k, bound)):
            kept.append(k)
    return kept


def _step(
    value: Callable[[FloatArray], float], x: FloatArray, k: int, space: ParameterSpace, centre: float, one_sigma: float
) -> float:
    """A step that raises the objective by about a tenth of one_sigma, within the room that the bounds leave."""
    room = 0.99 * float(min(x[k] - space.low[k], space.high[k] - x[k], 1e6))
    step = min(1e-3, room)
    for _ in range(12):
        rise = 0.0
        for sign in (-1.0, 1.0):
            moved = x.copy()
            moved[k] += sign * step
            rise += 0.5 * (value(moved) - centre)
        if not math.isfinite(rise):
            step *= 0.3
            continue
        wanted = 0.1 * one_sigma
        if 0.2 * wanted < rise < 5 * wanted:
            break
        # Rounding of the objective can hide the rise altogether.
        factor = min(max(math.sqrt(wanted / rise), 0.05), 20.0) if rise > 1e-14 * abs(centre) else 20.0
        if step * factor >= room:
            step = room
            break
        step *= factor
    return step


def _second(
    value: Callable[[FloatArray], float], x: FloatArray, i: int, j: int, hi: float, hj: float, centre: float
) -> float:
    def at(si: float, sj: float) -> float:
        moved = x.copy()
        moved[i] += si * hi
        if i != j:
            moved[j] += sj * hj
        return value(moved)

    if i == j:
        bent: float = at(1, 0) - 2 * centre + at(-1, 0)
        return bent / (hi * hi)
    crossed: float = at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)
    return crossed / (4 * hi * hj)
