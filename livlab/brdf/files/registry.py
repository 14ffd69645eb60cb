"""The formats of BRDF files, a row each: suffixes, help and refusals of the command are derived from here.

To add one: a module beside this one that ends in `FILE = FileFunctions(...)`, a row in `FORMATS`, and a maker of seeds
in `fuzz/brdf_seeds.py`. Importing this module loads none of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import cast

from livlab.brdf.files.interface import FileFunctions
from livlab.errors import InputError


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    name
        What fuzzing and messages call it.
    suffixes
        In lower case, the usual one first.
    module
        Where its `FILE` is.
    holds
        What is in such a file.
    refused
        What is not read or not written, in words.
    written
        Whether livlab writes it; or by what else it is written.
    in_help
        How the help of `convert` names it, its first suffix if empty.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    holds: str
    refused: str
    written: bool | str = True
    in_help: str = ""

    def functions(self) -> FileFunctions:
        """Its functions, imported now.

        Raises
        ------
        TypeError
            They write where the row says that nothing does, or the other way round.
        """
        found = cast(FileFunctions, import_module(self.module).FILE)
        if (found.write is not None) != (self.written is True):
            raise TypeError(f"{self.module} and the row {self.name} disagree about whether it is written")
        return found


FORMATS: dict[str, Format] = {
    row.name: row
    for row in (
        Format(
            "netcdf",
            (".nc",),
            "livlab.brdf.files.netcdf",
            "samples or table, every bit, conventions as attributes",
            "other conventions",
        ),
        Format("csv", (".csv",), "livlab.brdf.files.csv", "samples, see below", "columns of other names"),
        Format(
            "merl",
            (".binary",),
            "livlab.brdf.files.merl",
            "MERL: 90 × 90 × 180 cells, θ_h by square root, φ_d in [0, π), scales 1/1500, 1.15/1500, 1.66/1500; "
            "holes are −1",
            "a file of another length; other than 1 or 3 channels, negative values",
        ),
        Format(
            "mitsuba",
            (".bsdf",),
            "livlab.brdf.files.mitsuba",
            "Mitsuba's `measured`, isotropic, RGB or spectral",
            "anisotropic files; holes, unless filled or zero",
        ),
        Format(
            "alta",
            (".alta", ".dat", ".data", ".txt"),
            "livlab.brdf.files.alta",
            "ALTA's text: `#DIM`, `#PARAM_IN`, `#PARAM_OUT`, then numbers in radians",
            "other parametrisations than below",
            written=False,
            in_help=".alta, .txt",
        ),
        Format(
            "fit",
            (".json",),
            "livlab.brdf.files.fitted",
            "a fitted model: converts to all of these, evaluated where they have their values",
            "models that livlab does not have",
            written="by `fit -o`",
            in_help="a fit's .json",
        ),
    )
}
"""Every format by name."""


def read_suffixes() -> tuple[str, ...]:
    """Suffixes of files that are read."""
    return tuple(suffix for row in FORMATS.values() for suffix in row.suffixes)


def written_suffixes() -> tuple[str, ...]:
    """Suffixes of files that are written."""
    return tuple(suffix for row in FORMATS.values() if row.written is True for suffix in row.suffixes)


def format_to_read(path: Path) -> Format:
    """The format of a file by its suffix.

    Raises
    ------
    InputError
        A suffix that is not known.
    """
    return _of(path, read_suffixes(), "Rename it after its format.")


def format_to_write(path: Path) -> Format:
    """The format that a suffix asks for.

    Raises
    ------
    InputError
        A suffix that is not known or not written.
    """
    return _of(path, written_suffixes(), "Choose a format by suffix.")


def in_words(last: str = "or") -> str:
    """The usual suffixes of what is written, for help: `.a, .b or .c`; all by commas if `last` is empty.

    >>> in_words()
    '.nc, .csv, .binary or .bsdf'
    """
    found = [row.suffixes[0] for row in FORMATS.values() if row.written is True]
    return f"{', '.join(found[:-1])} {last} {found[-1]}" if last else ", ".join(found)


def sources_in_words() -> str:
    """What is converted, for help."""
    found = [row.in_help or row.suffixes[0] for row in FORMATS.values()]
    return f"{', '.join(found[:-1])}, or {found[-1]}"


def formats_table() -> str:
    """The formats as a table in Markdown, for the documentation."""
    lines = ["| suffix | read | written | holds | refused |", "|---|---|---|---|---|"]
    for row in FORMATS.values():
        suffixes = ", ".join(f"`{suffix}`" for suffix in row.suffixes)
        written = row.written if isinstance(row.written, str) else "yes" if row.written else "no"
        lines.append(f"| {suffixes} | yes | {written} | {row.holds} | {row.refused} |")
    return "\n".join(lines)


def _of(path: Path, known: tuple[str, ...], remedy: str) -> Format:
    suffix = path.suffix.lower()
    if suffix not in known:
        raise InputError.of("path", path.name, f"must end in one of {', '.join(known)}", remedy)
    return next(row for row in FORMATS.values() if suffix in row.suffixes)
