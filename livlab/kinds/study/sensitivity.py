"""Sensitivity: Sobol indices and Morris's elementary effects by SALib, with intervals, and whether they settled."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from livlab.errors import InputError, LivlabError
from livlab.kinds.study.config_parts import Sensitivity
from livlab.units import FloatArray

FLAT = 1e-9
"""Spread of an output, as a share of its level, below which it counts as constant."""

LEAST_BLOCKS = 8
"""Complete blocks without which nothing is estimated."""

LEAST_SHARE = 0.9
"""Share of the blocks that must be complete: to drop more would change the box that is asked about."""

SOBOL = ("factor", "first", "first_interval", "total", "total_interval")
MORRIS = ("factor", "mu", "mu_star", "mu_star_interval", "sigma")


def unit_design(spec: Sensitivity, factors: int, seed: int) -> FloatArray:
    """(M, factors) points in the unit cube, in blocks of one base point each.

    Sobol indices: Saltelli's design (2002, 2010), a block being A, the A with one column of B each, and B. Morris:
    trajectories (Morris 1991).

    Parameters
    ----------
    spec
        Estimator, base points, levels.
    factors
        D ≥ 1.
    seed
        Of the scrambling or of the trajectories.
    """
    problem = _problem([str(k) for k in range(factors)])
    if spec.estimator == "sobol":
        from SALib.sample.sobol import sample  # type: ignore[import-untyped]

        return np.asarray(sample(problem, spec.points, calc_second_order=False, seed=seed), dtype=np.float64)
    from SALib.sample.morris import sample as morris  # type: ignore[import-untyped]

    return np.asarray(morris(problem, spec.points, num_levels=spec.levels, seed=seed), dtype=np.float64)


def check_blocks(spec: Sensitivity, factors: int, empty: Mapping[int, LivlabError]) -> None:
    """Refuse a design with more blocks that hold a point without a tissue than an estimate can do without.

    Raises
    ------
    InputError
        There are more.
    """
    if not empty:
        return
    bad = {k // spec.block(factors) for k in empty}
    if len(bad) > (1.0 - LEAST_SHARE) * spec.points or spec.points - len(bad) < min(LEAST_BLOCKS, spec.points):
        first = next(iter(empty.values()))
        raise InputError.of(
            "factor", f"{len(bad)} of {spec.points} blocks of the design with a point that is no tissue",
            f"leave no indices, which need {LEAST_SHARE:.0%} of the blocks whole; the first: "
            f"{first.message.rstrip('.')}",
            f"Narrow the factors to where every point is a tissue. {first.remedy}".rstrip(),
        )  # fmt: skip


def indices(spec: Sensitivity, unit: FloatArray, values: FloatArray, names: Sequence[str], seed: int) -> pd.DataFrame:
    """Indices of one output.

    First: V[E(y | x_i)] / V(y); total: E[V(y | all but x_i)] / V(y) (Saltelli et al. 2010, Table 2); Morris: mean,
    mean size and standard deviation of the elementary effects over the whole range of a factor.

    Parameters
    ----------
    spec, unit
        As `unit_design` took and gave.
    values
        (M,) the output; a block with a nan is left out.
    names
        Of the factors.
    seed
        Of the bootstrap.

    Returns
    -------
    One row a factor, columns `SOBOL` or `MORRIS`; `…_interval` is half the width of the interval.

    Raises
    ------
    InputError
        The indices are not defined: the output is constant, nan everywhere, or nan in too many blocks.
    """
    block = spec.block(unit.shape[1])
    y: FloatArray = values.reshape(-1, block)
    kept: NDArray[np.bool_] = np.asarray(np.isfinite(y).all(axis=1))
    if not np.isfinite(values).any():
        raise InputError.of("output", "nan at every point", "has no indices", "See why no point has a value.")
    if kept.sum() < min(LEAST_BLOCKS, len(y)) or kept.mean() < LEAST_SHARE:
        raise InputError.of(
            "output",
            f"{len(kept) - int(kept.sum())} of {len(kept)} blocks with a nan",
            "has no indices: too many points without a value",
            "Narrow the factors to where the tissue holds together.",
        )
    y = y[kept]
    level = float(np.abs(y).max())
    if float(np.ptp(y)) <= FLAT * level:
        raise InputError.of(
            "output", f"{level:g} at every point", "is flat: its indices are 0/0", "Vary what it depends on."
        )
    problem = _problem(names)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a factor that does nothing is an answer here, and no reason to warn
        if spec.estimator == "sobol":
            from SALib.analyze.sobol import analyze  # type: ignore[import-untyped]

            found = analyze(
                problem, y.ravel(), calc_second_order=False, num_resamples=spec.resamples, conf_level=spec.level,
                seed=seed + 1,
            )  # fmt: skip
            columns: dict[str, Any] = {
                "first": found["S1"],
                "first_interval": found["S1_conf"],
                "total": found["ST"],
                "total_interval": found["ST_conf"],
            }
        else:
            from SALib.analyze.morris import analyze as morris  # type: ignore[import-untyped]

            rows = np.repeat(kept, block)
            found = morris(
                problem, unit[rows], y.ravel(), num_resamples=spec.resamples, conf_level=spec.level,
                num_levels=spec.levels, seed=seed + 1,
            )  # fmt: skip
            columns = {
                "mu": found["mu"],
                "mu_star": np.asarray(found["mu_star"], dtype=np.float64),
                "mu_star_interval": found["mu_star_conf"],
                "sigma": found["sigma"],
            }
    return pd.DataFrame({"factor": list(names), **{k: np.asarray(v, dtype=np.float64) for k, v in columns.items()}})


def growth(spec: Sensitivity, unit: FloatArray, values: FloatArray, names: Sequence[str], seed: int) -> pd.DataFrame:
    """The same indices from a quarter, half and all of the base points: whether they have settled.

    Returns
    -------
    The rows of `indices`, with `points` in front; sizes that leave too few blocks are left out.
    """
    block = spec.block(unit.shape[1])
    made = []
    for count in (spec.points // 4, spec.points // 2, spec.points):
        if count < LEAST_BLOCKS and count < spec.points:
            continue
        rows = count * block
        try:
            found = indices(spec, unit[:rows], values[:rows], names, seed)
        except InputError:
            if count == spec.points:
                raise
            continue
        made.append(found.assign(points=count))
    frame = pd.concat(made, ignore_index=True)
    return frame[["points", *[c for c in frame.columns if c != "points"]]]


def settled(spec: Sensitivity, grown: pd.DataFrame) -> tuple[float, float]:
    """Half-width of the widest interval, and the largest change of an index from half of the points to all.

    Both for the total index, or for μ* as a share of the largest μ*. The change is nan where there is no half.
    """
    column = "total" if spec.estimator == "sobol" else "mu_star"
    last = grown[grown["points"] == grown["points"].max()].set_index("factor")
    unit = 1.0 if spec.estimator == "sobol" else float(last[column].max()) or 1.0
    widest = float(last[f"{column}_interval"].max()) / unit
    earlier = grown[grown["points"] < grown["points"].max()]
    if not len(earlier):
        return widest, float("nan")
    half = earlier[earlier["points"] == earlier["points"].max()].set_index("factor")
    return widest, float((last[column] - half[column]).abs().max()) / unit


def _problem(names: Sequence[str]) -> dict[str, Any]:
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}
