"""Whether the box of a fit's parameters holds tissues: told before any light is followed, with what mends it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from livlab.errors import InputError, LivlabError
from livlab.fitting.box import between, corners, refused, survey, why_not
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.tissue import Tissue, override
from livlab.optimise.parameters import ParameterSpace
from livlab.units import FloatArray

EDGE = 1e-3
"""Share of the box from the optimum within which it counts as being where the tissues end."""


class Room:
    """The tissues of all scenes of a fit, by the values of its parameters.

    Parameters
    ----------
    tissue, reading
        The tissue that was measured, and how it is read.
    scenes
        Of each scene, what is set in it, and the parameter that each path follows.
    space, labels
        The parameters, and what they are called, by name.
    seed
        Of the points that are tried by chance.
    """

    def __init__(
        self,
        tissue: Tissue,
        reading: Reading,
        scenes: Sequence[tuple[Mapping[str, Any], Mapping[str, str]]],
        space: ParameterSpace,
        labels: Mapping[str, str],
        seed: int,
    ) -> None:
        self.reading, self.space, self.labels, self.seed = reading, space, labels, seed
        self.keys = [keys for _, keys in scenes]
        self.tissues = [override(tissue, own, by="measurement") if own else tissue for own, _ in scenes]
        self.finite = np.isfinite(space.low) & np.isfinite(space.high)

    def __call__(self, values: Mapping[str, float]) -> list[Tissue]:
        """The tissues at given values of the parameters, as the reading takes them.

        Raises
        ------
        ConfigError, InputError
            There is none.
        """
        return [
            override(tissue, {path: values[key] for path, key in keys.items()}, by="fit").under(self.reading)
            for tissue, keys in zip(self.tissues, self.keys, strict=True)
        ]

    def at(self, u: FloatArray) -> list[Tissue]:
        """At a point of the unit cube: each free parameter between its (transformed) bounds."""
        space = self.space
        span = np.where(self.finite, space.high - space.low, 0.0)
        return self(space.values(np.where(self.finite, space.low, space.start) + u * span))

    def unit(self, values: Mapping[str, float]) -> FloatArray:
        """Values of the parameters as a point of the unit cube."""
        space = self.space
        span = np.where(self.finite & (space.high > space.low), space.high - space.low, 1.0)
        return np.where(self.finite, (space.vector(values) - space.low) / span, 0.5)

    def check_start(self) -> None:
        """Refuse a start that is no tissue.

        Raises
        ------
        InputError
            It is none; the parameter that leads out of the tissues, and where.
        """
        start = self.unit({})
        error = why_not(self.at, start)
        if error is None:
            return
        inside = next((c for c in self._likely(start) if why_not(self.at, c) is None), None)
        if inside is None:
            values = self.space.values(self.space.vector({}))
            given = ", ".join(f"{self.labels[key]} = {value:g}" for key, value in values.items())
            raise InputError.of(
                "parameter", given, f"is no tissue at the start: {error.message.rstrip('.')}",
                error.remedy or "Mend the path or the start.",
            )  # fmt: skip
        self._check_ends(inside)
        at = inside.copy()
        for k in range(len(start)):
            there = at.copy()
            there[k] = start[k]
            limit = between(self.at, at, there, k)
            if limit is None:
                at = there
                continue
            p, value, last = self._named(k), *(self._value(k, x[k]) for x in (there, limit.at))
            said = "" if self.space.free[k].start is not None else " (the middle of its bounds, since none is given)"
            raise InputError.of(
                f"parameter {p}.start", value,
                f"is no tissue at the start{said}: beyond {p} = {last:.4g} {limit.error.message.rstrip('.')}",
                f"Give start = {self._value(k, inside[k]):.4g}, say. {limit.error.remedy}".rstrip(),
            )  # fmt: skip

    def check(self) -> str:
        """What to say of a box that is partly no tissue; empty where all of it is.

        Raises
        ------
        InputError
            A bound that no tissue reaches.
        """
        found = self._check_ends(self.unit({}))
        if found is None:
            return ""
        return (
            f"About {found[0]:.0%} of the box that the bounds span is no tissue: {_because(found[1])} Such points cost "
            "infinity, and the search keeps out of them."
        )

    def _check_ends(self, start: FloatArray) -> tuple[float, LivlabError] | None:
        """Share of the box that is no tissue and why, None if there is none."""
        found = survey(self.at, start, self.seed)
        for limit in found.limits:
            k = limit.dimension
            p = self.space.free[k]
            bound, given = ("high", p.high) if limit.high else ("low", p.low)
            raise refused(
                limit, f"parameter {self._named(k)}", bound, given, self._value(k, limit.at[k]), self._named(k)
            )
        return None if found.error is None else (found.empty, found.error)

    def ends_at(self, best: Mapping[str, float]) -> list[str]:
        """Sentences on parameters that end where the tissues do: the optimum may lie beyond."""
        made = []
        at = self.unit(best)
        for k in range(len(at)):
            for step in (EDGE, -EDGE):
                there = at.copy()
                there[k] = at[k] + step
                error = why_not(self.at, there) if 0.0 <= there[k] <= 1.0 else None
                if error is not None:
                    made.append(
                        f"{self._named(k)} = {best[self.space.names[k]]:.4g} sits where the tissues end: "
                        f"{_because(error)} The optimum may lie beyond, and its interval ends there. {error.remedy}"
                    )
        return made

    def _likely(self, start: FloatArray) -> list[FloatArray]:
        """Points of the cube that may be tissues where the start is none: halfway, and the corners."""
        return [0.5 * start, *corners(len(start), self.seed), 0.5 * (1.0 + start)]

    def _named(self, k: int) -> str:
        return self.labels[self.space.names[k]]

    def _value(self, k: int, share: float) -> float:
        space = self.space
        x = space.start.copy()
        x[k] = space.low[k] + share * (space.high[k] - space.low[k])
        return space.values(x)[space.names[k]]


def _because(error: LivlabError) -> str:
    return f"{error.message.rstrip('.')}."


__all__ = ["Room"]
