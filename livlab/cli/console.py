"""Where the commands print, and whether there is a place for what they write."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from livlab.core.files import missing_folder
from livlab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console


def table_console(width: int, *, stderr: bool = False) -> Console:
    """A console on which tables have so many characters into a pipe or file, where 80 would fold them."""
    from rich.console import Console

    tty = (sys.stderr if stderr else sys.stdout).isatty()
    return Console(stderr=stderr, width=None if tty else width)


def check_output(path: Path, suffixes: tuple[str, ...] = ()) -> None:
    """See, before hours of work, that a file can be written.

    Raises
    ------
    InputError
        Its suffix is none of those that there are, or its folder does not exist.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError.of("output", path.name, f"must end in one of {', '.join(suffixes)}", "Choose by suffix.")
    folder = path.resolve().parent
    if not folder.is_dir():
        raise InputError.of("output", str(path), "lies in no folder that there is", missing_folder(folder))
