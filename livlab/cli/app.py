"""The `livlab` command and its error boundary."""

from __future__ import annotations

import sys

import typer
from rich.console import Console

from livlab.cli import data, doctor, fractions, run
from livlab.errors import LivlabError

app = typer.Typer(
    name="livlab",
    help="Say how light and living tissue meet, and prove it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(data.app, name="data")
doctor.register(app)
run.register(app)
fractions.register(app)


def main() -> None:
    """Run the command line; an error livlab raised on purpose is a message and a remedy, not a traceback."""
    console = Console(stderr=True)
    try:
        app()
    except LivlabError as error:
        console.print(f"[bold red]error:[/] {_plain(error.message)}", highlight=False)
        if error.remedy:
            console.print(f"[bold]remedy:[/] {_plain(error.remedy)}", highlight=False)
        sys.exit(error.exit_code)


def _plain(text: str) -> str:
    return text.replace("[", r"\[")
