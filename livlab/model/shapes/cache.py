"""Arrays that took long to make, kept on disk under the digest of what they were made from.

A cache is a convenience: where it cannot be read or written, what was asked for is made again and nobody is told.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import platformdirs
from numpy.typing import NDArray

LIMIT_BYTES = 2 << 30
"""Above this the files not used for longest are removed."""


def key(*parts: object) -> str:
    """Digest of the parts' representations.

    >>> key("liver", 140.0) == key("liver", 140.0), key("liver", 140.0) == key("liver", 141.0)
    (True, False)
    """
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:40]


def recall(kind: str, name: str) -> dict[str, NDArray[np.generic]] | None:
    """Arrays kept under this name, or None."""
    file = _file(kind, name)
    if file is None:
        return None
    try:
        with np.load(file, allow_pickle=False) as kept:
            arrays = {field: kept[field] for field in kept.files}
        os.utime(file)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return arrays


def remember(kind: str, name: str, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Keep arrays under this name, whole or not at all."""
    file = _file(kind, name)
    if file is None:
        return
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=".", suffix=".tmp", dir=file.parent)
        try:
            with os.fdopen(handle, "wb") as stream:
                np.savez(stream, allow_pickle=False, **arrays)
            Path(temporary).replace(file)
        finally:
            Path(temporary).unlink(missing_ok=True)
        _prune(file.parent.parent)


def _file(kind: str, name: str) -> Path | None:
    folder = Path(platformdirs.user_cache_dir("livlab"))
    return folder / "shapes" / kind / f"{name}.npz" if folder.is_absolute() else None


def _prune(folder: Path) -> None:
    files = sorted((file.stat().st_mtime, file.stat().st_size, file) for file in folder.glob("*/*.npz"))
    excess = sum(size for _, size, _ in files) - LIMIT_BYTES
    for _, size, file in files[:-1]:
        if excess <= 0:
            return
        file.unlink(missing_ok=True)
        excess -= size
