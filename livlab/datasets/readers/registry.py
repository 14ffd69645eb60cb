"""The readers of spectra, a row each: which file is whose, by how it begins and what it is called.

To add one: a module beside this one with a function from a path to a `RawTable`, and a row in `READERS`. What only that
reader needs is imported inside its function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from livlab.datasets.readers.raw import RawTable, beginning
from livlab.datasets.readers.text import read_text


@dataclass(frozen=True)
class Reader:
    """A reader of one file format.

    Parameters
    ----------
    label
        What the format is called.
    read
        The table of a file; `InputError` for what is damaged.
    identify
        Whether a file of that path that begins with these bytes is one of the format.
    extensions
        In lower case; none: a file of any name may be one.
    priority
        Of several readers whose file it is, the one with the highest reads it.
    """

    label: str
    read: Callable[[Path], RawTable]
    identify: Callable[[Path, bytes], bool]
    extensions: tuple[str, ...] = ()
    priority: int = 0

    def takes(self, path: Path, start: bytes) -> bool:
        """Whether the file is this reader's."""
        return (not self.extensions or path.suffix.lower() in self.extensions) and self.identify(path, start)


READERS: dict[str, Reader] = {
    reader.label: reader
    for reader in (
        # Takes what no other reader knows, and says what a file is that is no text.
        Reader("text", read_text, identify=lambda path, start: True, priority=-100),
    )
}
"""Every reader by its label."""


def read_table(path: Path) -> RawTable:
    """Read a user's table with the reader whose file it is.

    Raises
    ------
    InputError
        If the file is missing, not a table that a reader knows, too large, empty, or has a cell that is not a finite
        number.
    EnvironmentProblem
        If it cannot be read.
    """
    start = beginning(path)
    return max((r for r in READERS.values() if r.takes(path, start)), key=lambda r: r.priority).read(path)
