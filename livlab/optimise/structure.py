"""What residuals hang on: one offset a group (a light, a stretch of wavelengths), or their order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from livlab.units import FloatArray

LIMIT = 1e-3
"""A model misses its data where one that is right would look so in less than one case of a thousand."""


@dataclass(frozen=True, eq=False)
class Grouping:
    """Residuals by groups.

    Attributes
    ----------
    name
        What the groups differ in: "light", "wavelength".
    index
        (n,) number of each residual's group; −1 for none.
    labels
        How a group is called in a sentence, with its preposition: "at light 4", "near 630 nm".
    fine
        Whether its groups are so small that one is named only if it is twice as bad as any of another grouping.
    """

    name: str
    index: npt.NDArray[np.intp]
    labels: tuple[str, ...]
    fine: bool = False

    @classmethod
    def of(cls, name: str, labels: ArrayLike, words: str = "at {}") -> Grouping:
        """From (n,) labels of any kind, each a group; `words` makes a phrase of one.

        >>> Grouping.of("light", [4, 4, 7], "at light {}").labels
        ('at light 4', 'at light 7')
        """
        found, index = np.unique(np.asarray(labels), return_inverse=True)
        return cls(name, index.ravel().astype(np.intp), tuple(words.format(label) for label in found))

    @classmethod
    def bins(cls, name: str, values: ArrayLike, edges: Sequence[float], words: str) -> Grouping:
        """From (n,) numbers and the edges of bins; `words` has {low}, {high} and {middle}.

        >>> Grouping.bins("theta_h", [1.0, 4.0], [0, 3, 6], "at theta_h {low:g} to {high:g} deg").labels[1]
        'at theta_h 3 to 6 deg'
        """
        index = np.digitize(np.asarray(values, dtype=np.float64), np.asarray(edges)) - 1
        index = np.where((index >= 0) & (index < len(edges) - 1), index, -1)
        pairs = itertools.pairwise(edges)
        labels = tuple(words.format(low=a, high=b, middle=0.5 * (a + b)) for a, b in pairs)
        return cls(name, index.astype(np.intp), labels)


@dataclass(frozen=True)
class Structure:
    """Whether residuals hang on something they should not.

    Attributes
    ----------
    name
        What they were grouped by, or "runs": their order.
    p
        Chance of offsets as large, or runs as few, of residuals that are independent.
    where, ratio
        The group with the largest residuals beyond chance, in words, and their size over the noise (or over that of
        all residuals where the noise is not known); "" and nan for runs.
    groups, dof
        How many groups, and degrees of freedom of the test.
    """

    name: str
    p: float
    where: str = ""
    ratio: float = math.nan
    groups: int = 0
    dof: int = 0


def runs_p(series: Sequence[FloatArray]) -> float:
    """Chance of so few runs of one sign (Wald & Wolfowitz 1940), over one or several ordered series of residuals.

    Small when neighbours have one sign too often. Up to 200 residuals exactly, with half the chance of the runs seen
    (mid-p); beyond by the normal limit. nan where all signs are alike in every series.
    """
    from scipy.special import ndtr

    runs = mean = variance = 0.0
    counts = []
    for values in series:
        signs = np.sign(values[values != 0])
        plus, minus = int(np.sum(signs > 0)), int(np.sum(signs < 0))
        if not plus or not minus:
            continue
        n = plus + minus
        found = 1 + int(np.sum(signs[1:] != signs[:-1]))
        counts.append((plus, minus, found))
        runs += found
        mean += 1 + 2 * plus * minus / n
        variance += 2 * plus * minus * (2 * plus * minus - n) / (n * n * (n - 1)) if n > 1 else 0.0
    if not counts or variance <= 0:
        return math.nan
    if len(counts) == 1 and sum(counts[0][:2]) <= 200:
        return _exact_runs(*counts[0])
    return float(ndtr((runs - mean) / math.sqrt(variance)))


def by_groups(
    g: Grouping, r: FloatArray, q: FloatArray, left: FloatArray, share: float, unit: float, least: float = 0.0
) -> tuple[Structure, tuple[str, float]]:
    """The F test of one offset a group, and the group with the largest residuals beyond chance.

    Parameters
    ----------
    g
        The groups.
    r
        (n,) residuals without their part along the model's directions.
    q
        (rank, n) orthonormal rows that span these.
    left
        (n,) share of its variance that each residual keeps.
    share
        Independent residuals over all.
    unit
        Size of one residual's noise.
    least
        Variance below which that of the rest is not believed: the noise's own, where residuals lie far below it.
    """
    from scipy.special import fdtrc

    inside = g.index >= 0
    index, size = g.index[inside], len(g.labels)
    count = np.bincount(index, minlength=size).astype(np.float64)
    sums = np.bincount(index, weights=r[inside], minlength=size)
    along = np.array([np.bincount(index, weights=row[inside], minlength=size) for row in q]).reshape(len(q), size)
    some = count > 0
    # Frisch & Waugh 1933: groups first; what is left of the model's directions beside them, then.
    kept = np.eye(len(q)) - (along[:, some] / count[some]) @ along[:, some].T
    cross = -(along[:, some] / count[some]) @ sums[some]
    eigen, vectors = np.linalg.eigh(kept) if len(q) else (np.zeros(0), np.zeros((0, 0)))
    good = eigen > 1e-9
    explained = float(np.sum(sums[some] ** 2 / count[some]))
    explained += float(np.sum((vectors[:, good].T @ cross) ** 2 / eigen[good]))
    top = int(some.sum()) + int(good.sum()) - len(q)
    rest = r.size - len(q) - top
    squares = np.bincount(index, weights=r[inside] ** 2, minlength=size)
    where, ratio = _peak(
        g, squares / unit**2, np.asarray(np.bincount(index, weights=left[inside], minlength=size), float), share
    )
    total = float(np.einsum("n,n->", r, r))
    if top < 1 or rest < 1 or total <= 0:
        return Structure(g.name, math.nan, where, ratio, int(some.sum()), max(top, 0)), (where, ratio)
    f = explained / top / max((total - explained) / rest, least, 1e-300 * total)
    p = float(fdtrc(top, max(rest * share, 1.0), f * share))
    return Structure(g.name, p, where, ratio, int(some.sum()), top), (where, ratio)


def _peak(g: Grouping, chi2: FloatArray, expected: FloatArray, share: float) -> tuple[str, float]:
    """Of the groups whose χ² is beyond chance the one with the largest ratio, or else that with the least chance."""
    from scipy.special import gammaincc

    some = expected > 1e-6
    if not np.any(some):
        return "", math.nan
    ratio = np.sqrt(np.where(some, chi2 / np.where(some, expected, 1.0), 0.0))
    chance = np.where(some, gammaincc(0.5 * np.maximum(expected, 1e-6) * share, 0.5 * chi2 * share), 1.0)
    sure = some & (chance < LIMIT / some.sum())
    k = int(np.argmax(np.where(sure, ratio, 0.0))) if np.any(sure) else int(np.argmin(chance))
    return g.labels[k], float(ratio[k])


def _exact_runs(plus: int, minus: int, runs: int) -> float:
    """P(fewer runs) + ½ P(so many)."""

    def ways(count: int) -> int:
        half = count // 2
        if count % 2 == 0:
            return 2 * math.comb(plus - 1, half - 1) * math.comb(minus - 1, half - 1)
        return math.comb(plus - 1, half) * math.comb(minus - 1, half - 1) + math.comb(plus - 1, half - 1) * math.comb(
            minus - 1, half
        )

    total = math.comb(plus + minus, plus)
    return (sum(ways(k) for k in range(2, runs)) + 0.5 * ways(runs)) / total
