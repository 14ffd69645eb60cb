"""Resampling: how far parameters move when the data are drawn again, sample by sample or block by block."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from livlab.errors import InputError, LivlabError
from livlab.units import FloatArray


@dataclass(frozen=True, eq=False)
class BootstrapResult:
    """Replicates of a fit.

    Attributes
    ----------
    replicates
        One row a replicate, one column a parameter.
    failures
        Replicates whose fit failed.
    blocks
        How many blocks were drawn from.
    """

    replicates: pd.DataFrame
    failures: int
    blocks: int

    @property
    def sd(self) -> dict[str, float]:
        """Standard deviation by name."""
        return {str(k): float(v) for k, v in self.replicates.std(ddof=1).items()}

    def intervals(self, level: float = 0.6827) -> pd.DataFrame:
        """Percentile intervals (Efron & Tibshirani 1993, ch. 13): lower, median, upper by name."""
        if not 0 < level < 1:
            raise InputError.of("level", level, "must lie between 0 and 1", "Use 0.6827 for one standard deviation.")
        shares = [0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level]
        frame = self.replicates.quantile(shares).T
        frame.columns = pd.Index(["lower", "median", "upper"])
        frame.index.name = "parameter"
        return frame


def block_weights(labels: ArrayLike, rng: np.random.Generator) -> FloatArray:
    """How often each sample comes when whole blocks are drawn with replacement (Künsch 1989).

    Parameters
    ----------
    labels
        (n,) block of each sample; give each its own for the plain bootstrap.
    rng
        Where chance comes from.

    Returns
    -------
    (n,) counts; equal within a block.
    """
    _, index = np.unique(np.asarray(labels), return_inverse=True)
    count = int(index.max()) + 1
    drawn = np.bincount(rng.integers(0, count, count), minlength=count)
    return np.asarray(drawn[index], dtype=np.float64)


def bootstrap(
    refit: Callable[[FloatArray], Mapping[str, float]],
    labels: ArrayLike,
    *,
    replicates: int = 200,
    seed: int = 0,
) -> BootstrapResult:
    """Refit with blocks drawn with replacement; residuals that hang together within a block stay together.

    Parameters
    ----------
    refit
        Takes (n,) weights that multiply the squared residuals, gives parameters by name.
    labels
        (n,) block of each sample.
    replicates
        How often.
    seed
        Of the draws.

    Raises
    ------
    InputError
        Fewer than two blocks or replicates, or no fit that succeeded.
    """
    names = np.unique(np.asarray(labels))
    if names.size < 2:
        raise InputError.of("labels", names.size, "must name at least two blocks", "Split the samples into more.")
    if replicates < 2:
        raise InputError.of("replicates", replicates, "must be at least 2", "Ask for a few dozen.")
    rng = np.random.default_rng(seed)
    rows: list[dict[str, float]] = []
    failures = 0
    for _ in range(replicates):
        weights = block_weights(labels, rng)
        try:
            rows.append({str(k): float(v) for k, v in refit(weights).items()})
        except (LivlabError, ArithmeticError, np.linalg.LinAlgError):
            failures += 1
    if len(rows) < 2:
        raise InputError.of("refit", f"{failures} failures", "must succeed at least twice", "Try the fit on its own.")
    frame = pd.DataFrame(rows)
    frame.index.name = "replicate"
    return BootstrapResult(frame, failures, int(names.size))
