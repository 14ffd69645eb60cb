"""What a runner hands back, and how runners are known by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from livlab.units import FloatArray


@dataclass(frozen=True)
class Measured:
    """Values of one quantity over a case's sweep, with standard errors where they are Monte Carlo."""

    value: FloatArray
    error: FloatArray = field(default_factory=lambda: np.zeros(1))
    note: str = ""


Runner = Callable[..., Mapping[str, Measured]]
RUNNERS: dict[str, Runner] = {}
"""Runners by the name that the catalogue calls them."""


def runner(function: Runner) -> Runner:
    """Make a function a runner under its own name."""
    RUNNERS[function.__name__] = function
    return function


def values(**found: Any) -> dict[str, Measured]:
    """Deterministic results by name."""
    return {name: Measured(np.atleast_1d(np.asarray(x, dtype=np.float64))) for name, x in found.items()}


def index(nk: list[float] | float) -> complex:
    """N − ik from the catalogue's [n, k]."""
    return complex(nk[0], -nk[1]) if isinstance(nk, list) else complex(nk)
