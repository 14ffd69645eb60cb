"""How sure a BRDF fit is: covariance and bootstrap over the same blocks, effective number of samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pandas as pd

from livlab.brdf.fit.data import DIRECTIONS, TILE
from livlab.brdf.fit.problem import BrdfProblem
from livlab.errors import InputError
from livlab.optimise import Covariance, block_weights, covariance_of_residuals
from livlab.optimise.covariance import normal_quantile
from livlab.units import FloatArray

Resampling = Literal["auto", "lights", "tiles", "samples"] | None
"""What counts as independent: whole lights, patches of pictures, or single samples. None: as "auto", nothing drawn."""

FEW = 100
"""Blocks up to which each is left out in turn: a light that alone shows something counts as it should."""

BIASES = "what all lights share, such as the scale, and biases: wrong directions of lights widen a lobe"
"""What lights cannot show by their scatter."""

FEWEST = 6
"""Blocks from which "auto" takes whole lights, or else patches; fewer say too little about their own scatter."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Uncertainties at the optimum.

    Attributes
    ----------
    independent
        Covariance as if all residuals were independent.
    robust
        Covariance with residuals that hang together within the blocks (sandwich).
    intervals
        Over the same blocks: lower, upper by parameter; bootstrap percentiles, or from `robust` if nothing was drawn.
    resampled
        What the blocks are, in words.
    left_out
        Which errors neither `robust` nor `intervals` can hold, since they are alike in all blocks.
    effective
        Number of independent residuals that scatter as these do.
    widened
        By which factor sd and interval of a parameter were widened since the model misses the data; 1 where not.
    """

    independent: Covariance
    robust: Covariance
    intervals: pd.DataFrame
    resampled: str
    left_out: str
    effective: float
    widened: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Blocks:
    """Which samples hang together: a label for each, what the blocks are, and which errors they cannot show."""

    labels: np.ndarray
    count: int
    words: str
    left_out: str

    def factor(self, level: float) -> float:
        """Half-width in standard deviations of an interval from so many blocks: Student's t with count − 1 degrees."""
        from scipy.special import stdtrit

        normal_quantile(level)  # refuses levels that are none
        return float(stdtrit(self.count - 1, 0.5 + 0.5 * level))


class Normal:
    """Per-block normal equations: Jᵀr (blocks, k) and JᵀJ (blocks, k, k), for any labels of the samples."""

    def __init__(self, problem: BrdfProblem, values: dict[str, float]) -> None:
        names = list(problem.layout.space.names)
        self.names = names
        self.problem = problem
        self.parts = []
        residuals = problem.residuals(values)
        for c, r in enumerate(residuals):
            own, rows = problem.columns(values, c)
            self.parts.append(([names.index(n) for n in own], rows, r))

    def information(self) -> FloatArray:
        """JᵀJ (k, k)."""
        total = np.zeros((len(self.names), len(self.names)))
        for index, rows, _ in self.parts:
            total[np.ix_(index, index)] += np.einsum("an,bn->ab", rows, rows)
        return total

    def jacobian(self) -> dict[str, FloatArray]:
        """Columns whose inner products are JᵀJ: its Cholesky-like root by eigenvalues, one short column each."""
        eigen, vectors = np.linalg.eigh(self.information())
        root = (vectors * np.sqrt(np.maximum(eigen, 0.0))) @ vectors.T
        return {name: root[:, k] for k, name in enumerate(self.names)}

    def scores(self, labels: np.ndarray) -> FloatArray:
        """Jᵀr of each block (blocks, k)."""
        found, index = np.unique(labels, return_inverse=True)
        total = np.zeros((found.size, len(self.names)))
        for own, rows, r in self.parts:
            for k, row in zip(own, rows, strict=True):
                total[:, k] += np.bincount(index, weights=row * r, minlength=found.size)
        return total

    def blocks(self, labels: np.ndarray) -> FloatArray:
        """JᵀJ of each block (blocks, k, k)."""
        found, index = np.unique(labels, return_inverse=True)
        total = np.zeros((found.size, len(self.names), len(self.names)))
        for own, rows, _ in self.parts:
            for a, j in enumerate(own):
                for b, k in enumerate(own[: a + 1]):
                    part = np.bincount(index, weights=rows[a] * rows[b], minlength=found.size)
                    total[:, j, k] += part
                    if j != k:
                        total[:, k, j] += part
        return total


def spread(
    problem: BrdfProblem,
    values: dict[str, float],
    *,
    resampling: Resampling,
    replicates: int,
    level: float,
    seed: int,
) -> Spread:
    """Covariances, bootstrap and effective number of samples.

    The sandwich is that of clusters, (JᵀJ)⁻¹ [n/(n − 1) Σ_blocks s sᵀ] (JᵀJ)⁻¹ with the scores s = Jᵀr of n blocks
    (Liang & Zeger 1986); of up to 100 blocks, which may weigh unlike, it is the jackknife that leaves out one after
    another (CR3 in Cameron & Miller 2015). The bootstrap draws the same blocks and is the linear one: each replicate
    moves the optimum by one Gauss–Newton step of the reweighted normal equations (Shao & Tu 1995, section 3.1.4 calls
    it one-step), since a full refit of each costs minutes. Its percentiles are expanded for n blocks (Hesterberg 2015):
    without that a dozen lights make intervals a tenth too narrow.
    """
    normal = Normal(problem, values)
    data = problem.data
    count = sum(r.size for _, _, r in normal.parts)
    rss = sum(float(np.einsum("n,n->", r, r)) for _, _, r in normal.parts)
    # A model that fits to the last digit has no scatter left to speak of; rounding stands in for it.
    rounding = 1e-30 * float(np.mean(problem.loss.target**2))
    variance = max(rss / max(count - len(normal.names), 1), rounding, 1e-300)
    jacobian = normal.jacobian()
    space = problem.layout.space
    independent = covariance_of_residuals(jacobian, space, values, variance=variance)
    blocks = blocks_of(problem, resampling)
    robust = sandwich(normal, blocks.labels, values, jacobian)
    words = blocks.words
    if resampling is None or replicates < 2 or not normal.names:
        intervals = robust.intervals(2.0 * _normal_share(blocks.factor(level)) - 1.0)[["lower", "upper"]]
    else:
        intervals = _bootstrap(normal, robust, values, blocks, replicates, level, seed)
        words += f", {replicates} replicates"
    return Spread(independent, robust, intervals, words, blocks.left_out, _effective(normal, data.tile, count, rss))


def scatter_of_blocks(normal: Normal, labels: np.ndarray) -> FloatArray:
    """Covariance (k, k) of Jᵀr over blocks that are independent; of up to a hundred each is left out in turn."""
    scores = normal.scores(labels)
    count = len(scores)
    if count <= FEW:
        scores = _left_out(normal, labels, scores)
        return np.asarray(scores.T @ scores * ((count - 1) / count))
    return np.asarray(scores.T @ scores * (count / (count - 1)))


def sandwich(
    normal: Normal, labels: np.ndarray, values: dict[str, float], jacobian: dict[str, FloatArray] | None = None
) -> Covariance:
    """Covariance of the parameters by the scatter between blocks."""
    between = scatter_of_blocks(normal, labels)
    scatter = {(a, b): float(between[j, k]) for j, a in enumerate(normal.names) for k, b in enumerate(normal.names)}
    root = normal.jacobian() if jacobian is None else jacobian
    return covariance_of_residuals(root, normal.problem.layout.space, values, variance=1.0, scatter=scatter)


def _left_out(normal: Normal, labels: np.ndarray, scores: FloatArray) -> FloatArray:
    """JᵀJ times the step by which the optimum moves when a block is left out, for each block (blocks, k)."""
    whole = normal.information()
    steps = [
        np.linalg.pinv(whole - own, rcond=1e-12, hermitian=True) @ s
        for own, s in zip(normal.blocks(labels), scores, strict=True)
    ]
    return np.array(steps - np.mean(steps, axis=0)) @ whole


def _effective(normal: Normal, tiles: np.ndarray, count: int, rss: float) -> float:
    """Residuals over the design effect Σ_blocks (Σ r)² / Σ r² (Kish 1965), at least one; channels hang together too."""
    _, index = np.unique(tiles, return_inverse=True)
    together = np.sum([r for _, _, r in normal.parts], axis=0)
    sums = max(float(np.sum(np.bincount(index, weights=together) ** 2)), float(np.sum(together**2)))
    return count / max(sums / rss, 1.0) if rss > 0 else float(count)


def blocks_of(problem: BrdfProblem, resampling: Resampling) -> Blocks:
    """What counts as independent, as `Resampling` says."""
    data = problem.data
    lights, tiles = np.unique(data.light).size, np.unique(data.tile).size
    if resampling in ("auto", None):
        resampling = "lights" if lights >= FEWEST else "tiles" if tiles >= FEWEST else "samples"
    if resampling == "lights":
        if lights < 2:
            raise InputError.of("bootstrap", "lights", "needs at least two lights", "Use tiles.")
        return Blocks(data.light, lights, f"whole lights ({lights})", BIASES)
    if resampling == "tiles":
        if tiles < 2:
            raise InputError.of("bootstrap", "tiles", "needs at least two patches", "Use samples.")
        what = "cells of 4 x 4 deg" if data.footprint == DIRECTIONS else f"patches of {TILE} x {TILE} pixels"
        rest = "what a whole light shares, such as its strength and direction, or all lights do"
        return Blocks(data.tile, tiles, f"{what} ({tiles})", rest)
    return Blocks(np.arange(data.size), data.size, f"single samples ({data.size})", "whatever samples share")


def _normal_share(z: float) -> float:
    from scipy.special import ndtr

    return float(ndtr(z))


def _bootstrap(
    normal: Normal,
    found: Covariance,
    values: dict[str, float],
    drawn: Blocks,
    replicates: int,
    level: float,
    seed: int,
) -> pd.DataFrame:
    labels = drawn.labels
    space = found.space
    inside = [normal.names.index(n) for n in found.matrix.index]
    x = space.vector(values)
    slopes = space.slopes(x)[inside] / space.unit[inside]  # dp/dt
    scores = normal.scores(labels)[:, inside] * slopes
    few = scores.shape[0] <= 4000
    blocks = normal.blocks(labels)[:, inside][:, :, inside] * np.outer(slopes, slopes) if few else None
    whole = normal.information()[np.ix_(inside, inside)] * np.outer(slopes, slopes)
    rng = np.random.default_rng(seed)
    t = np.array([space.by_name[n].inward(values[n]) for n in found.matrix.index])
    moved = []
    names = np.arange(scores.shape[0])
    for _ in range(replicates):
        weight = block_weights(names, rng)
        information = whole if blocks is None else np.tensordot(weight, blocks, axes=1)
        moved.append(t - np.linalg.pinv(information, rcond=1e-12, hermitian=True) @ (weight @ scores))
    share = _normal_share(drawn.factor(level) * math.sqrt(drawn.count / (drawn.count - 1)))
    low, high = np.quantile(np.array(moved), [1.0 - share, share], axis=0)
    return pd.DataFrame(
        {
            "lower": [space.by_name[n].outward(float(v)) for n, v in zip(found.matrix.index, low, strict=True)],
            "upper": [space.by_name[n].outward(float(v)) for n, v in zip(found.matrix.index, high, strict=True)],
        },
        index=found.matrix.index,
    )
