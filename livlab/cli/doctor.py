"""`livlab doctor`: what this machine has, what it lacks, and how to mend it."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from livlab.machine.version import __version__

_STYLES = {"ok": "green", "note": "cyan", "warning": "yellow", "blocked": "bold red"}


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command("doctor")(doctor)


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Look at Python, packages, libLLVM, variants, GPU and machine; exit with 3 when something blocks."""
    from livlab.machine.doctor import blocked, examine

    findings = examine()
    if as_json:
        record = {
            "livlab": __version__,
            "blocked": blocked(findings),
            "findings": [asdict(finding) for finding in findings],
        }
        typer.echo(json.dumps(record, indent=2))
    else:
        console = Console()
        table = Table(title=f"livlab {__version__}", title_justify="left", show_lines=False)
        for heading in ("what", "state", "found"):
            table.add_column(heading, overflow="fold", no_wrap=heading != "found")
        for finding in findings:
            found = Text(finding.detail)
            if finding.remedy:
                found.append(f"\nremedy: {finding.remedy}", style="bold")
            table.add_row(finding.topic, Text(finding.state, style=_STYLES[finding.state]), found)
        console.print(table)
        troubles = [finding for finding in findings if finding.state in ("warning", "blocked")]
        if blocked(findings):
            trouble = _count(len(troubles), "trouble")
            console.print(Text(f"{trouble}; simulations cannot run before the red ones are mended."))
        elif troubles:
            console.print(Text(f"Simulations can run; {_count(len(troubles), 'warning')}."))
        else:
            console.print(Text("Everything livlab needs is here."))
    if blocked(findings):
        raise typer.Exit(3)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")
