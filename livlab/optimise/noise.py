"""How large noise is, where nobody says: from repeats, from neighbours; and what correlated numbers are worth."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike


def noise_of_repeats(values: ArrayLike, labels: ArrayLike) -> tuple[float, int]:
    """Standard deviation of one value and its degrees of freedom, of (n, ...) values that repeat within (n,) labels."""
    array = np.asarray(values, dtype=np.float64).reshape(len(np.asarray(values)), -1)
    _, index, counts = np.unique(np.asarray(labels), return_inverse=True, return_counts=True)
    index = index.ravel()
    total = 0.0
    for column in array.T:
        mean = np.bincount(index, weights=column) / counts
        total += float(np.sum((column - mean[index]) ** 2))
    dof = int((len(array) - counts.size) * array.shape[1])
    return (math.sqrt(total / dof), dof) if dof > 0 else (math.nan, 0)


def noise_of_neighbours(values: ArrayLike) -> tuple[float, float]:
    """Standard deviation of evenly spaced values about a curve that is smooth over three of them, and its degrees.

    Pseudo-residuals (y_{i−1} − 2 y_i + y_{i+1})/√6 (Gasser, Sroka & Jennen-Steinmetz 1986, eq. 2); since neighbouring
    ones share values, n − 2 of them are worth (n − 2)/(1 + 2 (4/9 + 1/36)) degrees of freedom. What curves within three
    values counts as noise.
    """
    y = np.asarray(values, dtype=np.float64).ravel()
    if y.size < 3:
        return math.nan, 0.0
    bent = (y[:-2] - 2.0 * y[1:-1] + y[2:]) / math.sqrt(6.0)
    return float(np.sqrt(np.mean(bent**2))), bent.size / (1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0))


def effective_number(residuals: ArrayLike) -> float:
    """How many independent numbers an ordered series of correlated noise is worth: n/(1 + 2 Σ ρ_k).

    ρ_k are the autocorrelations, summed while neighbouring pairs of them stay positive (Geyer 1992). Structure that a
    wrong model leaves counts as correlation, too: take it of repeats, or of a model that is known to fit.
    """
    r = np.asarray(residuals, dtype=np.float64).ravel()
    r = r - r.mean()
    n, level = r.size, float(r @ r)
    if n < 4 or level <= 0:
        return float(n)
    rho = np.array([float(r[: n - k] @ r[k:]) / level for k in range(n // 2)])
    pairs = rho[: rho.size // 2 * 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    inflation = 2.0 * float(pairs[: ends[0] if ends.size else None].sum()) - 1.0
    return float(n / max(inflation, 1.0))
