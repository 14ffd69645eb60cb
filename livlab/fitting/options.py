"""How a fit is sought."""

from __future__ import annotations

import math
from dataclasses import dataclass

MOST_RECORDINGS = 5
"""Recordings after which a search that still moves is told as not settled."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How a fit is sought, and what its intervals are to claim.

    Attributes
    ----------
    algorithm, starts, max_evaluations, max_seconds
        As `livlab.optimise.minimise`, for the first search; later ones start from its optimum.
    seed
        Of the first recording; each later one has another.
    most_recordings
        Recordings, two at least, after which it ends unsettled.
    level
        Coverage of the intervals.
    """

    algorithm: str | tuple[str, ...] = "auto"
    starts: int = 1
    seed: int = 1
    max_evaluations: int | None = None
    max_seconds: float = math.inf
    most_recordings: int = MOST_RECORDINGS
    level: float = 0.95

    @property
    def stages(self) -> tuple[str, ...]:
        """The algorithm's stages by name."""
        return (self.algorithm,) if isinstance(self.algorithm, str) else tuple(self.algorithm)

    @property
    def by_gradient(self) -> bool:
        """Whether every stage asks for derivatives with each value."""
        return all(name == "auto" or name.startswith("LD_") for name in self.stages)
