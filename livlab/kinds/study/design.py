"""The points of a study, and which of them are no tissue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from livlab.errors import InputError, LivlabError
from livlab.kinds.study.config import StudyExperiment
from livlab.kinds.study.points import Base
from livlab.kinds.study.room import StudyRoom


@dataclass(frozen=True)
class Design:
    """Points of a study, and which of them are no tissue.

    Attributes
    ----------
    points
        Value by path.
    empty
        What is wrong with those that are no tissue, by number.
    beside
        Points beside the design, all tissues, that tell what each factor does alone.
    """

    points: list[dict[str, Any]]
    empty: Mapping[int, LivlabError]
    beside: tuple[dict[str, Any], ...] = ()

    def tissues(self) -> list[dict[str, Any]]:
        """The points that are tissues."""
        return [point for k, point in enumerate(self.points) if k not in self.empty]

    def whole(self, curves: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Curves of the tissues with those of all points, which say why there is none."""
        given = iter(curves)
        return [
            {"error": self.empty[k].message, "seconds": 0.0} if k in self.empty else next(given)
            for k in range(len(self.points))
        ]

    def note(self) -> str:
        """What a report must say of the points that are no tissue."""
        first = next(iter(self.empty.values()))
        return (
            f"{len(self.empty)} of {len(self.points)} points are no tissue: they were not simulated, and stand in "
            f"results.csv with their reason. The first: {first.message} {first.remedy}".rstrip()
        )


def laid_out(config: StudyExperiment, points: list[dict[str, Any]], beside: Sequence[dict[str, Any]] = ()) -> Design:
    """Points of a study, those that are no tissue told apart, and those beside it that are tissues.

    Raises
    ------
    InputError
        None is a tissue.
    """
    room = StudyRoom(Base(config.tissue.build(), config.reading, config.instrument), config.factor)
    empty = room.empty(points)
    if len(empty) == len(points):
        first = next(iter(empty.values()))
        raise InputError.of(
            "factor", f"{len(points)} points", f"none is a tissue; the first: {first.message.rstrip('.')}",
            first.remedy or "Mend the tissue, or the factors' bounds.",
        )  # fmt: skip
    return Design(points, empty, tuple(p for p in beside if room.why_not(p) is None))


__all__ = ["Design", "laid_out"]
