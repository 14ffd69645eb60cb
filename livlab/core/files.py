"""Files that are either whole or not there, for every layer of the house."""

from __future__ import annotations

import contextlib
import errno
import os
import shlex
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from livlab.errors import EnvironmentProblem, InputError

DENSEST = 1100
"""Bytes that a byte of deflated data can stand for, at most (RFC 1951: 258 from two bits)."""

REMEDIES = {
    errno.ENOSPC: "Free some space, or name another folder with --out.",
    errno.EDQUOT: "Your quota is used up: free some space, or name another folder with --out.",
    errno.EROFS: "The file system is read-only: name another folder with --out.",
    errno.EACCES: "Ask for permission to write there, or name another folder with --out.",
    errno.EPERM: "Ask for permission to write there, or name another folder with --out.",
    errno.ENOTDIR: "A file stands where a folder is needed: name another folder with --out.",
    errno.EEXIST: "A file stands where a folder is needed: name another folder with --out.",
    errno.ENAMETOOLONG: "Use a shorter name, or a shorter --out.",
}


def readable(
    path: Path, field: str, most_bytes: int, remedy: str = "Check the path.", error: type[InputError] = InputError
) -> Path:
    """The path of a user's file, if it is a plain file of a size that may be read whole.

    A named pipe would be waited for without end, a device has no end, and a file as large as the disk is a mistake.

    Raises
    ------
    InputError
        (or `error`) It is missing, no plain file, or larger than `most_bytes`.
    """
    try:
        status = path.stat()
    except OSError as trouble:
        raise error.of(field, str(path), f"cannot be read ({trouble.strerror or trouble})", remedy) from trouble
    except ValueError as trouble:  # a zero byte
        raise error.of(field, str(path), "is not a file name", remedy) from trouble
    if not stat.S_ISREG(status.st_mode):
        raise error.of(field, str(path), "is not a plain file", remedy)
    if status.st_size > most_bytes:
        bound = f"has {status.st_size / 2**20:.1f} MiB, more than the {most_bytes / 2**20:g} MiB that it may have"
        raise error.of(field, str(path), bound, remedy)
    return path


def first_line(error: BaseException) -> str:
    """What a library's error says, in one line of at most 160 characters."""
    said = (str(error).strip().splitlines() or [""])[0][:160]
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def missing_folder(folder: Path) -> str:
    """What to do about a folder in which nothing can be written: make it, or, where none can be made, go elsewhere.

    Whether one can be made is tried, since permissions do not tell: a kernel's file system grants and refuses.
    """
    there = folder.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    if not there.is_dir():
        return f"{there} is a file: choose another folder."
    try:
        with tempfile.TemporaryDirectory(prefix=".livlab-", dir=there):
            pass
    except OSError:
        return f"Nothing can be written in {there}: choose another folder."
    if folder.is_dir():
        return "It vanished while it was in use: try again, or choose another folder."
    return f"Make the folder first (mkdir -p {shlex.quote(str(folder))}), or choose another."


@contextlib.contextmanager
def told_plainly(path: Path) -> Iterator[None]:
    """Turn an `OSError` inside into an `EnvironmentProblem` that names the path and the remedy."""
    try:
        yield
    except OSError as error:
        if error.errno == errno.ENOENT:
            remedy = missing_folder(path.parent)
        else:
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
