"""Files that are either whole or not there, for every layer of the house."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from livlab.errors import EnvironmentProblem

REMEDIES = {
    errno.ENOSPC: "Free some space, or name another folder with --out.",
    errno.EDQUOT: "Your quota is used up: free some space, or name another folder with --out.",
    errno.EROFS: "The file system is read-only: name another folder with --out.",
    errno.EACCES: "Ask for permission to write there, or name another folder with --out.",
    errno.EPERM: "Ask for permission to write there, or name another folder with --out.",
    errno.ENOENT: "Make the folder first, or name another one.",
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
        remedy = REMEDIES.get(error.errno or 0, "Check the disk, or name another folder with --out.")
        raise EnvironmentProblem(f"Cannot write {path}: {error.strerror or error}.", remedy=remedy) from error


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` for a library that writes files itself; it takes the name when all went well.

    The temporary name keeps the suffix, by which such libraries know the format.

    Raises
    ------
    EnvironmentProblem
        The disk is full, read-only or forbidden; the old file, if any, is untouched and nothing is left behind.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    with told_plainly(path):
        try:
            temporary.touch()  # a folder that is missing or forbidden is told by the system, not by the library
            yield temporary
            with temporary.open("rb+") as stream:
                os.fsync(stream.fileno())
            temporary.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)


def write_whole(path: Path, content: bytes | str | memoryview) -> None:
    """Write a file so that a reader, or a crash, finds the old one or the new one and nothing between.

    Raises
    ------
    EnvironmentProblem
        The disk is full, read-only or forbidden; the old file, if any, is untouched and nothing is left behind.
    """
    with whole(path) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else bytes(content))


def _sync_folder(folder: Path) -> None:
    with contextlib.suppress(OSError):  # some file systems cannot; the rename itself has happened
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
