"""TOML from a user's file: what Python cannot take well is one kind of error, whatever it is."""

from __future__ import annotations

import tomllib
from typing import Any

DEEPEST = 32
"""Levels of tables and lists; an experiment has seven."""

LARGEST = 2**63
"""TOML's whole numbers have 64 bits; Python's have no end, and printing a huge one is an error of its own."""


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML.

    Raises
    ------
    tomllib.TOMLDecodeError
        Not TOML, nested deeper than `DEEPEST`, or a whole number beyond 64 bits: where the parser itself would end in
        a `RecursionError` or a bare `ValueError`, or what it gives in either later.

    Examples
    --------
    >>> parse_toml("a.b = 1")
    {'a': {'b': 1}}
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise tomllib.TOMLDecodeError(f"nested more than {DEEPEST} levels deep") from None
    except ValueError as error:  # a number of thousands of digits
        raise tomllib.TOMLDecodeError(str(error)[:100]) from None
    heap: list[tuple[int, str, Any]] = [(0, "", data)]
    while heap:
        depth, name, value = heap.pop()
        if depth > DEEPEST:
            raise tomllib.TOMLDecodeError(f"nested more than {DEEPEST} levels deep")
        if isinstance(value, dict):
            heap += [(depth + 1, key, inner) for key, inner in value.items()]
        elif isinstance(value, list):
            heap += [(depth + 1, name, inner) for inner in value]
        elif isinstance(value, int) and not -LARGEST <= value < LARGEST:
            raise tomllib.TOMLDecodeError(f"{name[:80]} is a whole number beyond 64 bits")
    return data
