"""Compilation by numba that works where nothing can be cached, and never runs the machine code of another version.

Import this module only where a kernel is needed: numba takes a third of a second to load.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])

_CONSTANTS = (bool, int, float, complex, str, tuple)


def compiled(function: F, *, nogil: bool = False) -> F:
    """Compile on first call and keep the machine code on disk where some folder allows it.

    By IEEE 754 to the letter: no `fastmath`, not even fused multiply-adds. numba compiles its own helpers (an integer
    power, say) once a process by the flags of whoever calls first, so with flags a result depended on what had been
    compiled before it; and fusing gives other bytes on a processor that cannot.

    numba refuses to keep anything if neither the package's folder nor the user's cache can be written; then the kernel
    is compiled anew in each process. What it keeps it knows by the source file's time and size and by the function's
    bytecode. That misses a changed constant, a changed kernel in another module, changed options here, and a file
    saved while a process that had loaded the former one was about to compile. So the name that it is kept under ends
    with a digest of all of these.
    """
    options = {"nogil": nogil}
    function.__qualname__ += f"_{_digest(function, str(options))}"
    try:
        made = numba.njit(cache=True, **options)(function)
    except RuntimeError:
        made = numba.njit(**options)(function)
    return made  # type: ignore[no-any-return]


def _digest(function: Any, options: str) -> str:
    """Of the code that is loaded, of its file, and of the constants and kernels that it names."""
    told = hashlib.sha256(options.encode())
    seen: set[int] = set()
    left = [function]
    while left:
        one: FunctionType = left.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        code = one.__code__
        told.update(code.co_code + repr([c for c in code.co_consts if not isinstance(c, CodeType)]).encode())
        with suppress(OSError):  # a package inside an archive
            told.update(Path(code.co_filename).read_bytes())
        for name in code.co_names:
            value = one.__globals__.get(name)
            kernel = getattr(value, "py_func", None)
            if kernel is not None:
                left.append(kernel)
            elif isinstance(value, _CONSTANTS):
                told.update(f"{name}={value!r}".encode())
    return told.hexdigest()[:16]
