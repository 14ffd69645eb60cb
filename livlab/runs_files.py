"""Files that are either whole or not there: atomic writes, a lock on a folder, hashes."""

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

from livlab.errors import EnvironmentProblem

SPACE_BYTES = 16 << 20
"""Free space that a run wants before it starts: a few times what a spectral run writes."""

_REMEDIES = {
    errno.ENOSPC: "Free some space, or name another folder with --out.",
    errno.EDQUOT: "Your quota is used up: free some space, or name another folder with --out.",
    errno.EROFS: "The file system is read-only: name another folder with --out.",
    errno.EACCES: "Ask for permission to write there, or name another folder with --out.",
    errno.EPERM: "Ask for permission to write there, or name another folder with --out.",
    errno.ENOTDIR: "A file stands where a folder is needed: name another folder with --out.",
    errno.EEXIST: "A file stands where a folder is needed: name another folder with --out.",
    errno.ENAMETOOLONG: "Use a shorter name, or a shorter --out.",
}


@contextlib.contextmanager
def told_plainly(path: Path) -> Iterator[None]:
    """Turn an `OSError` inside into an `EnvironmentProblem` that names the path and the remedy."""
    try:
        yield
    except OSError as error:
        remedy = _REMEDIES.get(error.errno or 0, "Check the disk, or name another folder with --out.")
        raise EnvironmentProblem(f"Cannot write {path}: {error.strerror or error}.", remedy=remedy) from error


def write_whole(path: Path, content: bytes | str | memoryview) -> None:
    """Write a file so that a reader, or a crash, finds the old one or the new one and nothing between.

    Raises
    ------
    EnvironmentProblem
        The disk is full, read-only or forbidden; the old file, if any, is untouched and nothing is left behind.
    """
    raw = content.encode("utf-8") if isinstance(content, str) else bytes(content)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with told_plainly(path):
        try:
            with temporary.open("wb") as stream:
                stream.write(raw)
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)


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
            remedy=_REMEDIES[errno.ENOSPC],
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
        for leftover in folder.rglob(".*.tmp"):
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


def _sync_folder(folder: Path) -> None:
    with contextlib.suppress(OSError):  # some file systems cannot; the rename itself has happened
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
