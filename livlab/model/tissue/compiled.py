"""Compilation by numba that works where nothing can be cached.

Import this module only where a kernel is needed: numba takes a third of a second to load.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile on first call and keep the machine code on disk where some folder allows it.

    numba refuses to decorate at all if neither the package's folder nor the user's cache can be written;
    then the kernel is compiled anew in each process.
    """
    try:
        made = numba.njit(cache=True, fastmath={"contract"})(function)
    except RuntimeError:
        made = numba.njit(function)
    return made  # type: ignore[no-any-return]
