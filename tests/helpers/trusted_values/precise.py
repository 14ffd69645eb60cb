"""Arithmetic of many digits for the trusted values: mpmath, which only those who compute them need."""

from __future__ import annotations

import importlib
from typing import Any

from livlab.errors import EnvironmentProblem


def mpmath() -> Any:
    """The library.

    Raises
    ------
    EnvironmentProblem
        Where it is not installed; the values that the catalogue needs are stored in `trusted.csv`.
    """
    try:
        return importlib.import_module("mpmath")
    except ImportError:
        raise EnvironmentProblem(
            "mpmath is not installed: trusted values cannot be computed anew.",
            remedy="Install livlab with its dev extra.",
        ) from None


def spread(*arguments: Any) -> list[tuple[Any, ...]]:
    """Arguments as rows: lists of one length count up together, everything else stays.

    >>> spread([1, 2], 3)
    [(1, 3), (2, 3)]
    """
    length = max([len(x) for x in arguments if isinstance(x, list)], default=1)
    return [tuple(x[k] if isinstance(x, list) else x for x in arguments) for k in range(length)]
