"""Intervals where a model misses its data, and where a parameter sits at a bound."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from livlab.brdf.fit.spread import Blocks, Normal, Spread, sandwich, scatter_of_blocks
from livlab.optimise.structure import Grouping


def widen(normal: Normal, values: dict[str, float], sure: Spread, groups: Sequence[Grouping]) -> Spread:
    """The spread where a model misses its data: as far as the parameters move when a part of the data is left out.

    Every grouping of the samples (lights, angles, places in the picture) takes the part of the blocks in turn, each
    group left out once (jackknife, one Gauss–Newton step, as in `spread`); of each parameter the largest of these sds
    counts, and that of independent residuals as large as these are. The interval is stretched about the value by the
    same factor, in the parameter's own transform, and ends at its bounds. What all parts of the data get wrong alike
    stays out.
    """
    if not len(sure.intervals):
        return sure
    largest = {name: sure.independent.transformed_sd.get(name, 0.0) for name in sure.intervals.index}
    for g in groups:
        if g.fine:
            continue
        other = sandwich(normal, g.index, values).transformed_sd
        largest = {n: max(s, other.get(n, 0.0)) for n, s in largest.items()}
    factors = {}
    for name, sd in largest.items():
        own = sure.robust.transformed_sd[name]
        factors[str(name)] = max(1.0, sd / own) if own > 0 and math.isfinite(sd) else 1.0
    by_name = sure.robust.space.by_name
    rows = {}
    for name, row in sure.intervals.iterrows():
        p = by_name[str(name)]
        t = p.inward(values[p.name])
        ends = [t + factors[p.name] * (p.inward(float(row[end])) - t) for end in ("lower", "upper")]
        rows[name] = {"lower": max(p.outward(ends[0]), p.low), "upper": min(p.outward(ends[1]), p.high)}
    grown = np.array([factors[n] for n in sure.robust.matrix.index])
    robust = replace(
        sure.robust,
        matrix=sure.robust.matrix * np.outer(grown, grown),
        sd={n: s * factors.get(n, 1.0) for n, s in sure.robust.sd.items()},
        transformed_sd={n: s * factors.get(n, 1.0) for n, s in sure.robust.transformed_sd.items()},
    )
    return replace(sure, robust=robust, intervals=pd.DataFrame.from_dict(rows, orient="index"), widened=factors)


def at_bounds(normal: Normal, values: dict[str, float], sure: Spread, blocks: Blocks, level: float) -> Spread:
    """Intervals of parameters at a bound, and what they do to those of the others, whose sd takes them as known.

    With the others at their best the loss goes as ½ A s² + g s with the distance s ≥ 0 from the bound; −g/A, where it
    would be without the bound, scatters between the blocks with a normal sd (times the largest widening). The interval
    ends where that normal, cut off at the bound, has `level` below it. The others' intervals reach as far as they move
    when s goes there.
    """
    from scipy.stats import truncnorm

    names, space = normal.names, normal.problem.layout.space
    held = [n for n in names if n not in sure.robust.matrix.index]
    if not held:
        return sure
    whole, between = normal.information(), scatter_of_blocks(normal, blocks.labels)
    slope = normal.scores(np.zeros(normal.problem.data.size, dtype=int))[0]
    inner = [k for k, n in enumerate(names) if n not in held]
    inverse = np.linalg.pinv(whole[np.ix_(inner, inner)], rcond=1e-12, hermitian=True)
    rows = {str(n): {"lower": float(r["lower"]), "upper": float(r["upper"])} for n, r in sure.intervals.iterrows()}
    for name in held:
        p, k = space.by_name[name], names.index(name)
        sign = 1.0 if values[name] - p.low < p.high - values[name] else -1.0
        moves = -inverse @ whole[np.ix_(inner, [k])][:, 0]
        way = np.zeros(len(names))
        way[inner], way[k] = moves, 1.0
        bend = float(way @ whole @ way)
        if not bend > 1e-12 * whole[k, k]:
            rows[name] = {"lower": p.low, "upper": p.high}
            continue
        middle, sd = (
            -sign * float(way @ slope) / bend,
            math.sqrt(float(way @ between @ way)) / bend * largest(sure.widened),
        )
        far = _one_sided(truncnorm, middle, sd, level, p.high - p.low)
        rows[name] = {"lower": p.low, "upper": p.low + far} if sign > 0 else {"lower": p.high - far, "upper": p.high}
        for j, move in zip(inner, moves, strict=True):
            q, shift = space.by_name[names[j]], sign * far * float(move)
            rows[q.name] = {
                "lower": max(rows[q.name]["lower"] + min(shift, 0.0), q.low),
                "upper": min(rows[q.name]["upper"] + max(shift, 0.0), q.high),
            }
    return replace(sure, intervals=pd.DataFrame.from_dict(rows, orient="index"))


def _one_sided(law: object, middle: float, sd: float, level: float, width: float) -> float:
    """Quantile at `level` of a normal cut off below 0 and beyond `width`."""
    if not sd > 0:
        return 0.0
    found = law.ppf(level, -middle / sd, max((width - middle) / sd, -middle / sd + 1e-9), middle, sd)  # type: ignore[attr-defined]
    return float(min(max(found, 0.0), width)) if np.isfinite(found) else width


def skew(lower: float, value: float, upper: float) -> bool:
    """Whether an interval reaches so unlike to its sides that ± says too little."""
    down, up = value - lower, upper - value
    return math.isfinite(down + up) and not (down > 0 and up > 0 and 2 / 3 < up / down < 1.5)


def largest(factors: Mapping[str, float]) -> float:
    """The largest factor by which an interval was widened."""
    return max(factors.values(), default=1.0)
