"""The `livlab` command and its error boundary."""

from __future__ import annotations

import errno
import sys
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from livlab.cli import bench, brdf, cost, data, doctor, fractions, gallery, mesh, plan, rerun, run, stress, validate
from livlab.errors import LivlabError
from livlab.machine.version import __version__

_REFUSED_BY_SYSTEM = {
    errno.ENOSPC: "Make room on the disk.",
    errno.EDQUOT: "Make room within the quota.",
    errno.EROFS: "Choose a folder that can be written.",
    errno.EACCES: "Check the permissions, or choose another place.",
    errno.EPERM: "Check the permissions, or choose another place.",
}

app = typer.Typer(
    name="livlab",
    help="Say how light and living tissue meet, and prove it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(data.app, name="data")
brdf.register(app)
doctor.register(app)
run.register(app)
rerun.register(app)
plan.register(app)
cost.register(app)
fractions.register(app)
stress.register(app)
mesh.register(app)
gallery.register(app)
bench.register(app)
validate.register(app)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"livlab {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Say how light and living tissue meet, and prove it."""


def main() -> None:
    """Run the command line; an error livlab raised on purpose is a message and a remedy, not a traceback."""
    try:
        app()
    except LivlabError as error:
        _report(error.message, error.remedy)
        sys.exit(error.exit_code)
    except MemoryError:
        _report("Out of memory.", "Ask for fewer samples or wavelengths at a time, or close other programs.")
        sys.exit(3)
    except OSError as error:
        if error.errno not in _REFUSED_BY_SYSTEM:
            raise
        place = f"{error.filename}: " if error.filename else ""
        _report(f"{place}{error.strerror}.", _REFUSED_BY_SYSTEM[error.errno])
        sys.exit(3)


def _report(message: str, remedy: str) -> None:
    """Print both to stderr, unwrapped, so that a path or a command can be copied."""
    console = Console(stderr=True)
    console.print(Text.assemble(("error: ", "bold red"), message), soft_wrap=True)
    if remedy:
        console.print(Text.assemble(("remedy: ", "bold"), remedy), soft_wrap=True)
