"""Arguments that a function does not have are told with the one that was meant."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from livlab.config.errors import nearest
from livlab.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")

_ELSEWHERE = {
    **dict.fromkeys(("samples", "photons", "n_photons"), "Say solver={'kind': 'walk', 'samples': …}, or accuracy=…."),
    **dict.fromkeys(("bounds", "params", "free"), "Bounds go into parameters={path: (low, high)}."),
    "tolerance": "Say accuracy=…, or give the solver its own: solver={'kind': 'adding-doubling', 'tolerance': …}.",
}


class ArgumentError(InputError, TypeError):
    """An argument that a function does not have."""


def explained(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function name the argument that was meant where it is given one it does not have.

    Raises
    ------
    ArgumentError
        When the function is called so.

    Examples
    --------
    >>> @explained
    ... def read(wavelengths_nm=None): ...
    >>> read(wavelength=5)
    Traceback (most recent call last):
        ...
    livlab.api.arguments.ArgumentError: read: wavelength = 5: is no argument. Did you mean 'wavelengths_nm'?
    """
    known = list(inspect.signature(function).parameters)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        for name, value in kwargs.items():
            if name not in known:
                meant = nearest(name, known) if name not in _ELSEWHERE else ""
                tissue = "Values of the tissue go into changes={path: value}. " if "changes" in known else ""
                hint = _ELSEWHERE.get(name) or meant or f"{tissue}It takes {', '.join(known)}."
                raise ArgumentError.of(f"{function.__name__}: {name}", value, "is no argument", hint)
        return function(*args, **kwargs)

    return call


__all__ = ["ArgumentError", "explained"]
