"""Factors that move nothing: whose whole range changes no output by more than its error, and why that may be.

A factor's own effect is the difference of points that differ in it alone: a grid, Saltelli's and Morris's designs are
full of such pairs; of a design that fills the box, a few points beside it are asked for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.kinds.study.config import StudyExperiment
from livlab.kinds.study.config_parts import Factor
from livlab.kinds.study.outputs import Number
from livlab.model.tissue.limits import limits_of
from livlab.optimise.covariance import normal_quantile

if TYPE_CHECKING:
    from livlab.units import FloatArray

NOTHING = 1e-3
"""Share of an output's level below which a change is none, however small the error: no instrument tells it."""

FALSE = 0.05
"""Probability that chance alone makes a factor without effect look as if it had one."""

MOST_WORDS = 8
"""Listed values of a factor that are tried beside a design."""

Point = Mapping[str, Any]


@dataclass(frozen=True)
class Move:
    """The largest change of an output over a factor's range.

    Attributes
    ----------
    output
        Its name.
    change, error
        Largest change between two points that differ in the factor alone, and its standard error.
    share
        The change over the output's level.
    none
        Whether it is no more than chance makes, or than a thousandth of the level.
    """

    output: str
    change: float
    error: float
    share: float
    none: bool


def moves(
    factors: Sequence[Factor],
    metrics: Mapping[str, str],
    points: Sequence[Point],
    made: Sequence[Mapping[str, Number]],
) -> dict[str, list[Move]]:
    """By factor, how much each output moves; nothing of an output without two finite values that can be compared.

    Parameters
    ----------
    factors
        What varies.
    metrics
        Metric of each output by name.
    points, made
        Value by path, and the outputs there.
    """
    found: dict[str, list[Move]] = {}
    for f in factors:
        groups: dict[str, list[int]] = {}
        for k, point in enumerate(points):
            groups.setdefault(repr({p: v for p, v in point.items() if p != f.path}), []).append(k)
        pairs = [g for g in groups.values() if len(g) > 1]
        each = (move(name, metric, made, pairs) for name, metric in metrics.items())
        found[f.name] = [m for m in each if m is not None]
    return found


def move(name: str, metric: str, made: Sequence[Mapping[str, Number]], groups: Sequence[Sequence[int]]) -> Move | None:
    """The largest change of one output within groups of points; None where there is nothing to compare.

    With n pairs, chance alone passes z = Φ⁻¹(1 − α/2n) standard errors with probability α at most (Bonferroni).
    """
    y = np.array([m[name].value for m in made], dtype=np.float64)
    se = np.array([m[name].standard_error for m in made], dtype=np.float64)
    usable = np.isfinite(y) & np.isfinite(se)
    level = _level(y[np.isfinite(y)], metric)
    kept = [np.array([k for k in g if usable[k]]) for g in groups]
    kept = [g for g in kept if len(g) > 1]
    if not kept:
        return None
    count = sum(len(g) * (len(g) - 1) // 2 for g in kept)
    z = normal_quantile(1.0 - FALSE / count)
    ends = [(g[np.argmin(y[g])], g[np.argmax(y[g])]) for g in kept]
    change = np.array([y[b] - y[a] for a, b in ends])
    error = np.array([math.hypot(se[a], se[b]) for a, b in ends])
    k = int(np.argmax(change))
    none = bool((change <= np.maximum(z * error, NOTHING * level)).all())
    return Move(name, float(change[k]), float(error[k]), float(change[k]) / level if level > 0 else 0.0, none)


def _level(y: FloatArray, metric: str) -> float:
    """What a change of an output is a share of; of a correlation its distance from 1."""
    if not y.size:
        return 0.0
    return float(np.abs(1.0 - y if metric == "pearson" else y).max())


def probes(config: StudyExperiment) -> list[dict[str, Any]]:
    """Points beside a design that fills the box: each factor at its ends, the others in their middle."""
    assert config.sweep is not None
    if config.sweep.design == "grid":
        return []
    middle = {f.path: f.at(0.5) for f in config.factor}
    made = []
    for f in config.factor:
        made += [{**middle, f.path: value} for value in f.ends()[:MOST_WORDS]]
    return made


def idle(config: StudyExperiment, found: Mapping[str, Sequence[Move]]) -> dict[str, str]:
    """By factor that moves nothing, what to say of it."""
    made = {}
    tissue = config.tissue.build()
    for f in config.factor:
        told = found.get(f.name, ())
        if not told or not all(m.none for m in told):
            continue
        most = max(told, key=lambda m: m.share)
        ends = "its values" if f.categorical else f"{f.low:g} to {f.high:g}"
        words = limits_of(tissue, f.path, config.reading)
        told_of = f"{f.name} moves no output over {ends} by more than its error or a thousandth: {said(most)}."
        made[f.name] = " ".join((told_of, *words))
    return made


def said(m: Move) -> str:
    """The largest change in words."""
    error = f" ± {m.error:.2g}" if m.error > 0 else ""
    return f"{m.output} by at most {m.change:.2g}{error}, {100 * m.share:.2g} % of its level"


def changes_nothing(change: float, error: float, level: float) -> bool:
    """Whether a single change is none: within three standard errors, or a thousandth of the level.

    >>> changes_nothing(3e-5, 0.0, 0.4), changes_nothing(0.01, 0.002, 0.4), changes_nothing(0.01, 0.01, 0.4)
    (True, False, True)
    """
    return abs(change) <= max(3.0 * error, NOTHING * level)


__all__ = ["Move", "changes_nothing", "idle", "move", "moves", "probes", "said"]
