"""Which points of a study are no tissue: told before any light is followed, with what mends it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.errors import InputError, LivlabError
from livlab.fitting.box import between, corners, refused
from livlab.kinds.study.config_parts import Factor
from livlab.kinds.study.points import Base

if TYPE_CHECKING:
    from livlab.units import FloatArray

MOST_WORDS = 64
"""Combinations of listed values that are tried at every corner; of more, the first."""

Point = Mapping[str, Any]


class StudyRoom:
    """The tissues of a study by its factors.

    Parameters
    ----------
    base
        Tissue, reading and instrument that the factors change.
    factors
        What varies.
    """

    def __init__(self, base: Base, factors: Sequence[Factor]) -> None:
        self.base, self.factors = base, tuple(factors)
        self.numbers = [f for f in factors if not f.categorical]
        self.words = [f for f in factors if f.categorical]

    def why_not(self, point: Point) -> LivlabError | None:
        """What is wrong at a point; None if it is a tissue under an instrument, as its reading takes it."""
        try:
            made = self.base.at(point)
            made.tissue.under(made.reading)
        except LivlabError as error:
            return error
        return None

    def check_ends(self) -> None:
        """Refuse a factor with an end that nothing can be at.

        Raises
        ------
        InputError
            A path that leads nowhere, a value that does not fit, or one that no tissue has, whatever the others are.
        """
        for f in self.factors:
            for value in f.ends():
                error = self.why_not({f.path: value})
                if error is None or self._beside_others(f, value):
                    continue
                self._refuse_bound(f, value)
                raise InputError.of(
                    f"factor {f.name}", f"{f.path} = {value}", f"does not fit: {error.message}",
                    error.remedy or "Mend the path or the value.",
                )  # fmt: skip

    def empty(self, points: Sequence[Point]) -> dict[int, LivlabError]:
        """Points that are no tissue, by number, and why.

        What a tissue forbids is convex in its numbers, so that a box whose corners are tissues holds nothing else.
        """
        if all(self.why_not(corner) is None for corner in self._corners()):
            return {}
        found = ((k, self.why_not(point)) for k, point in enumerate(points))
        return {k: error for k, error in found if error is not None}

    def _beside_others(self, f: Factor, value: Any) -> bool:
        """Whether a value makes a tissue beside ends of the other factors."""
        others = [x for x in self.factors if x is not f]
        sides = ({x.path: x.at(end) for x in others} for end in (0.0, 1.0))
        return any(self.why_not({**side, f.path: value}) is None for side in sides)

    def _refuse_bound(self, f: Factor, value: Any) -> None:
        """Say up to which value there are tissues, where the other end is one."""
        if f.categorical:
            return
        end = 1.0 if value == f.high else 0.0
        others = [x for x in self.factors if x is not f]
        for room in ({}, {x.path: x.at(0.0) for x in others}):

            def at(u: FloatArray, room: Point = room) -> None:
                error = self.why_not({**room, f.path: f.at(float(u[0]))})
                if error is not None:
                    raise error

            begin, there = np.array([1.0 - end]), np.array([end])
            if self.why_not({**room, f.path: f.at(1.0 - end)}) is None:
                limit = between(at, begin, there, 0)
                if limit is not None:
                    last = f.at(float(limit.at[0]))
                    raise refused(limit, f"factor {f.name}", "high" if end else "low", value, last, f.name)

    def _corners(self) -> Iterator[Point]:
        words = itertools.product(*(f.values or () for f in self.words))
        for chosen in itertools.islice(words, MOST_WORDS):
            fixed = {f.path: w for f, w in zip(self.words, chosen, strict=True)}
            for u in corners(len(self.numbers), 0):
                yield {**fixed, **{f.path: f.at(float(x)) for f, x in zip(self.numbers, u, strict=True)}}


__all__ = ["StudyRoom"]
