"""What every reader of spectra gives back, and how it gets at a user's file."""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from livlab.errors import EnvironmentProblem, InputError


@dataclass(frozen=True)
class RawTable:
    """A user's table as read.

    Attributes
    ----------
    source
        The file.
    headings
        Column headings as written, or None if the file has none.
    units
        Unit found in each heading's brackets, livlab's spelling, None where there is none.
    lines
        Line of the file that each row is on, as an editor counts.
    rows
        The numbers, one tuple a row.
    understood
        What was understood of the file's form, in sentences.
    """

    source: Path
    headings: tuple[str, ...] | None
    units: tuple[str | None, ...]
    lines: tuple[int, ...]
    rows: tuple[tuple[float, ...], ...]
    understood: tuple[str, ...]

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.rows[0])


def shown(path: Path) -> str:
    """Return a path as messages show it: a long one keeps its end, where the file's name is."""
    text = str(path)
    return text if len(text) <= 70 else f"...{text[-67:]}"


def suggested_name(path: Path) -> str:
    """Suggest a dataset name after the file's.

    >>> suggested_name(Path("Meu Fígado (2026).csv"))
    'meu_f_gado_2026'
    """
    return re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_")[:64].strip("_") or "my_dataset"


@contextlib.contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """A user's file, open; what is no regular file is refused, not waited for.

    Raises
    ------
    InputError
        If it is missing or no regular file.
    EnvironmentProblem
        If it cannot be read.
    """
    if "\0" in str(path):
        raise InputError.of("file", shown(path), "is not a file name", "Give the path of a CSV file.")
    try:
        # Non-blocking: a named pipe without a writer must not hang before it is refused.
        with os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb") as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise InputError.of("file", shown(path), "is not a regular file", "Give the path of a CSV file.")
            yield stream
    except FileNotFoundError as error:
        raise InputError.of("file", shown(path), "does not exist", "Check the path.") from error
    except (IsADirectoryError, NotADirectoryError) as error:
        raise InputError.of("file", shown(path), "is not a file", "Give the path of a CSV file.") from error
    except OSError as error:
        raise EnvironmentProblem(
            f"{path} cannot be read: {error.strerror or error}.", remedy="Check the path and its permissions."
        ) from error


def beginning(path: Path, length: int = 4096) -> bytes:
    """The first bytes of a file, by which readers know it; raises as `opened`."""
    with opened(path) as stream:
        return stream.read(length)


def whole(path: Path, most: int, remedy: str) -> bytes:
    """All bytes of a file of at most `most`; raises as `opened`, and `InputError` with the remedy if it has more."""
    with opened(path) as stream:
        length = os.fstat(stream.fileno()).st_size
        content = b"" if length > most else stream.read(most + 1)
        size = max(length, len(content))
        if size > most:
            raise InputError.of(
                "file",
                shown(path),
                f"has {size / 2**20:.1f} MiB, more than the {most // 2**20} MiB that a spectrum may have",
                remedy,
            )
        return content
