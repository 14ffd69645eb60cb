"""Who a run is: the digest of everything that decides its numbers, its folder, its manifest and its machine."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from livlab.config.schema import Experiment
from livlab.core.files import readable
from livlab.machine.origin import code, processor
from livlab.runs.files import plain_file, sha256

LARGEST_MANIFEST = 1 << 26
"""Bytes; a study of many jobs writes some MiB."""

RESULT_VERSION = 4
"""Raised whenever the same experiment would give other numbers than before, or call them otherwise; it is part of the
digest. `livlab.runs.old` knows what older results are called."""

_PACKAGES = ("numpy", "scipy", "xarray", "pandas", "pydantic", "miepython", "numba", "drjit", "mitsuba")


def canonical(config: Experiment) -> str:
    """The resolved experiment as one line of JSON: keys sorted, floats in shortest form, −0 as 0."""
    return json.dumps(_canonical(config.resolve().plain()), sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(config: Experiment, datasets: Mapping[str, str], result: int | None = None) -> str:
    """Hash of all that decides the numbers: resolved experiment, datasets' hashes, result version (this livlab's)."""
    version = RESULT_VERSION if result is None else result
    parts = {"config": canonical(config), "datasets": dict(sorted(datasets.items())), "result": version}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def folder_of(config: Experiment, identity: str, base: Path) -> Path:
    """Where a run with this digest lives."""
    return base / f"{config.name}-{identity[:12]}"


def is_complete(folder: Path, identity: str = "") -> bool:
    """Whether a folder holds a finished run whose files are as they were written."""
    manifest = read_manifest(folder)
    if manifest.get("status") != "complete" or (identity and manifest.get("digest") != identity):
        return False
    try:
        return all(plain_file(folder, name) and sha256(folder / name) == x for name, x in manifest["files"].items())
    except (OSError, KeyError, AttributeError):
        return False


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest, or nothing if there is none that can be read."""
    try:
        path = readable(folder / "manifest.json", "manifest", LARGEST_MANIFEST)
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):  # an InputError is a ValueError
        return {}
    return found if isinstance(found, dict) else {}


def dataset_hashes(names: Sequence[str]) -> dict[str, str]:
    """Hash of each dataset, after its table was held against its own meta.toml.

    Raises
    ------
    DatasetError
        One is missing, or its table is not the one that its hash was taken of.
    """
    if not names:
        return {}
    from livlab import datasets

    return {name: datasets.load(name).meta.sha256 for name in sorted(set(names))}


def machine() -> dict[str, Any]:
    """The machine and the versions of what computes, as a manifest has them."""
    import os
    from importlib import metadata

    packages = {}
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            packages[name] = metadata.version(name)
    return {
        "packages": packages,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "processor": processor(),
        "code": code(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "libllvm": None,
        "variant": None,
    }


def _canonical(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _canonical(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_canonical(v) for v in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            return str(value)
        return value + 0.0
    return value
