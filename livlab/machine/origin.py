"""What a number came out of, beside versions: the processor's name and livlab's own code."""

from __future__ import annotations

import hashlib
import platform
from contextlib import suppress
from functools import cache
from pathlib import Path


@cache
def processor() -> str:
    """The processor's name, as the system tells it; "" where it does not.

    Kernels are compiled for the processor they run on, so another one may give other last digits.
    """
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() in ("model name", "Model", "cpu model"):
                return value.strip()
    return platform.processor()


@cache
def code() -> str:
    """First 16 digits of the SHA-256 of the package's modules, names and contents; "" if they are no files.

    Two states of a working copy have one version number, and may have different results.

    >>> len(code())
    16
    """
    package = Path(__file__).parents[1]
    total = hashlib.sha256()
    modules = sorted(package.rglob("*.py"), key=lambda path: path.relative_to(package).as_posix())
    for path in modules:
        with suppress(OSError):
            total.update(f"{path.relative_to(package).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    return total.hexdigest()[:16] if modules else ""
