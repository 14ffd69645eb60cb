"""Forward models in closed form that stand in for a recorded walk in tests of fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Reply:
    """What a forward model answers, as `livlab.fitting.forward.Response`."""

    value: Any
    standard_error: Any
    valid: Any
    slopes: Any


class StandIn:
    """A curve over `x` by `curve`; recording keeps the seeds, and a subclass draws its noise there."""

    x: Any

    def record(
        self,
        centre: Mapping[str, float],
        others: Sequence[Mapping[str, float]] = (),
        *,
        seed: int = 1,
        coarser: float = 1.0,
        progress: Any = None,
    ) -> None:
        self.drawn(seed, coarser)

    def drawn(self, seed: int, coarser: float) -> None:
        """A new recording's draws; none here."""

    def curve(self, values: Mapping[str, float]) -> tuple[Any, Any, dict[str, Any]]:
        """Value, its standard error and its slopes."""
        raise NotImplementedError

    def there(self) -> Any:
        """Where it can answer: everywhere."""
        return np.ones(len(self.x), dtype=bool)

    def answer(self, values: Mapping[str, float], *, gradient: bool = False) -> Reply:
        value, error, slopes = self.curve(values)
        return Reply(value, error, self.there(), slopes if gradient else {})


@dataclass
class Decay(StandIn):
    """a e^(−k x), times (1 + noise of each recording)."""

    noise: float = 0.0
    records: list[int] = field(default_factory=list)
    draw: Any = field(default_factory=lambda: np.zeros(41))
    dead: bool = False
    x: Any = field(default_factory=lambda: np.linspace(0.0, 2.0, 41))

    def drawn(self, seed: int, coarser: float) -> None:
        self.records.append(seed)
        self.draw = self.noise * np.random.default_rng(seed).standard_normal(len(self.x))

    def curve(self, values: Mapping[str, float]) -> tuple[Any, Any, dict[str, Any]]:
        value = (1.0 + self.draw) * values["a"] * np.exp(-values["k"] * self.x)
        return value, self.noise * value, {"a": value / values["a"], "k": -self.x * value}

    def there(self) -> Any:
        return np.full(len(self.x), not self.dead)


class Wave(StandIn):
    """a (2 + cos k x): the square of its difference from data has a valley at every beat of k."""

    x = np.linspace(0.0, 2.0, 41)

    def curve(self, values: Mapping[str, float]) -> tuple[Any, Any, dict[str, Any]]:
        a, k = values["a"], values["k"]
        value = a * (2.0 + np.cos(k * self.x))
        slopes = {"a": value / a, "k": -a * self.x * np.sin(k * self.x)}
        if "b" in values:
            slopes["b"] = np.zeros(41)
        return value, np.zeros(41), slopes


_X = np.linspace(0.0, 2.0, 21)
SMOOTH = np.exp(-0.5 * ((_X[:, None] - _X) / 0.5) ** 2) + 1e-9 * np.eye(21)
"""Correlation of errors that hang together along the curve."""
_ROOT = np.linalg.cholesky(SMOOTH)


@dataclass
class Walked(StandIn):
    """a e^(−k x) + c, with errors that hang together along the curve, drawn anew by each recording."""

    sd: float = 0.01
    told: float = 1.0
    draw: Any = field(default_factory=lambda: np.zeros(21))
    x: Any = field(default_factory=lambda: _X)

    def drawn(self, seed: int, coarser: float) -> None:
        self.draw = self.sd * coarser * (_ROOT @ np.random.default_rng(seed).standard_normal(21))
        self.scale = coarser

    def curve(self, values: Mapping[str, float]) -> tuple[Any, Any, dict[str, Any]]:
        fall = np.exp(-values["k"] * self.x)
        slopes = {"a": fall, "k": -self.x * values["a"] * fall, "c": np.ones(21)}
        return values["a"] * fall + values["c"] + self.draw, np.full(21, self.sd * self.scale), slopes

    def noise_covariance(self, values: Mapping[str, float]) -> Any:
        """What it tells of its errors."""
        return self.told * (self.sd * self.scale) ** 2 * SMOOTH
