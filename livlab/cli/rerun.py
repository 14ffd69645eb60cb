"""`livlab rerun`: a run from its manifest, and what is different."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from livlab.errors import Interrupted

if TYPE_CHECKING:
    from livlab.kinds.again import Again

_COLOURS = {"differs": "bold red", "only before": "bold red", "only now": "bold red", "not compared": "dim"}


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("rerun")(rerun)


def rerun(
    run: Annotated[Path, typer.Argument(help="A run folder, runs/NAME-DIGEST, or a manifest.json.", metavar="RUN")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the new run folder; `reruns` beside RUN if not said.")
    ] = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Leave the report for later (livlab report).")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print only the new folder.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Run a run again from its manifest and compare the results byte by byte.

    Exit status 1 if they differ, or if a file of RUN was changed since.
    """
    from livlab.cli.progress import watched
    from livlab.kinds.again import as_record, read_original, run_again

    original = read_original(run)
    try:
        with watched(f"{original.name}, again", quiet=quiet or as_json) as progress:
            again = run_again(original, out, progress=progress, report=not no_report)
    except (KeyboardInterrupt, Interrupted):
        raise Interrupted("Stopped; nothing was compared.", remedy="Give the same command again.") from None
    if as_json:
        typer.echo(json.dumps(as_record(again), indent=2, ensure_ascii=False))
    else:
        if not quiet:
            _show(again)
        typer.echo(again.folder)
    if not again.same or again.changed:
        raise typer.Exit(1)


def _show(again: Again) -> None:
    console = Console()
    table = Table(header_style="bold", box=None, pad_edge=False)
    for column in ("file", "result", "where, and by how much"):
        table.add_column(column, overflow="fold")
    for file in again.files:
        colour = _COLOURS.get(file.verdict, "green")
        table.add_row(escape(file.name), f"[{colour}]{file.verdict}[/]", escape(file.detail))
    console.print(table)
    for difference in again.differences:
        console.print(f"not as it was: {difference}", markup=False, highlight=False)
    if not again.same and not again.differences:
        console.print("Versions, datasets and machine are as they were; what differs is the run itself.")
    for name in again.changed:
        gone = "lost" if not (again.original.folder / name).exists() else "changed"
        told = f"{gone} since the run: {name}. What it says is not what the run wrote; {again.folder / name} is."
        console.print(told, style="bold red", markup=False, highlight=False, soft_wrap=True)
    told = "The results are the same." if again.same else "The results differ."
    console.print(told, style="bold green" if again.same else "bold red", highlight=False)
