"""Files of a run: CSV, hashes, a lock on a folder; what is written is whole or not there (`livlab.core.files`)."""

from __future__ import annotations

import contextlib
import csv
import errno
import hashlib
import io
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from livlab.core.files import REMEDIES, told_plainly, write_whole
from livlab.errors import EnvironmentProblem

SPACE_BYTES = 16 << 20
"""Free space that a run wants before it starts: a few times what a spectral run writes."""


def csv_text(columns: Sequence[str], rows: Sequence[Mapping[str, object]]) -> str:
    r"""Rows as CSV with exactly these columns; a missing value is an empty cell, a float keeps nine digits.

    >>> csv_text(["a", "b"], [{"a": 0.1, "b": "x, y"}, {"a": None}])
    'a,b\n0.1,"x, y"\n,\n'
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        unknown = row.keys() - set(columns)
        if unknown:
            raise KeyError(f"no column for {sorted(unknown)}")
        writer.writerow([_cell(row.get(c)) for c in columns])
    return out.getvalue()


def read_csv(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV as text."""
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def plain_file(folder: Path, name: object) -> bool:
    """Whether a manifest's entry is a file of its folder: a device or a pipe would be read without end.

    >>> plain_file(Path("."), "../elsewhere")
    False
    """
    path = folder / str(name)
    return ".." not in path.parts and not Path(str(name)).is_absolute() and path.is_file()


def sha256(path: Path) -> str:
    """Hash of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def open_folder(folder: Path, space: int = SPACE_BYTES) -> None:
    """Make a folder and see that one may write there, with room to spare.

    Raises
    ------
    EnvironmentProblem
        It cannot be made, cannot be written, or the disk holds less than `space` bytes.
    """
    with told_plainly(folder):
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".probe.{os.getpid()}.tmp"
        try:
            probe.write_bytes(b"\0" * 4096)
        finally:
            with contextlib.suppress(OSError):
                probe.unlink(missing_ok=True)
        free = shutil.disk_usage(folder).free
    if free < space:
        raise EnvironmentProblem(
            f"Cannot write {folder}: {free / 2**20:.1f} MiB free, a run wants {space / 2**20:.0f} MiB.",
            remedy=REMEDIES[errno.ENOSPC],
        )


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for this process alone; the system frees the lock of a process that died.

    Raises
    ------
    EnvironmentProblem
        Another process holds it.
    """
    import fcntl

    path = folder / ".lock"
    with told_plainly(path):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.read(descriptor, 32).decode("ascii", "replace").strip() or "unknown"
            raise EnvironmentProblem(
                f"Another process ({owner}) is working on {folder}.",
                remedy="Wait until it is done and run again: the result will be there at once.",
            ) from None
        except OSError as error:
            raise EnvironmentProblem(
                f"Cannot lock {path}: {error.strerror or error}.", remedy="Name a folder on a local disk with --out."
            ) from error
        with told_plainly(path):
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        for leftover in folder.rglob(".*.tmp*"):
            leftover.unlink(missing_ok=True)
        yield
    finally:
        os.close(descriptor)


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.9g}"
    return str(value)


__all__ = [
    "csv_text",
    "locked",
    "open_folder",
    "plain_file",
    "read_csv",
    "sha256",
    "told_plainly",
    "write_whole",
]
