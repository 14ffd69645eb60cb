"""`livlab stress`: the catalogue of hard cases, run on this machine."""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from livlab.cli.console import check_output, table_console

if TYPE_CHECKING:
    from rich.console import Console

    from livlab.stress.catalogue import Case
    from livlab.stress.run import Line

_COLOURS = {"PASS": "green", "FAIL": "bold red", "MISSING": "yellow"}


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("stress")(stress)


def stress(
    only: Annotated[
        str | None, typer.Option("--only", help="Cases whose name holds or matches this: walk, mie/*, grazing.")
    ] = None,
    slow: Annotated[bool, typer.Option("--slow", help="The slow ones too.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="CSV to write the table to.")] = None,
) -> None:
    """Run hard cases against trusted values: tiny, huge, matched, grazing, unlike, empty. Exit with 1 if one fails."""
    from rich.console import Console

    from livlab.stress.catalogue import select
    from livlab.stress.run import run, write_csv

    chosen = select(only, slow=slow)
    if output is not None:
        check_output(output)
    started = time.perf_counter()
    console = table_console(180)
    follow = Console(stderr=True)

    def tell(case: Case, lines: Sequence[Line]) -> None:
        if follow.is_terminal:
            worst = min((x.verdict for x in lines), key=["FAIL", "MISSING", "PASS"].index)
            follow.print(f"{worst:<8}{case.name}", highlight=False, markup=False)

    lines = run(chosen, None if as_json else tell)
    if output is not None:
        write_csv(output, lines)
    if as_json:
        typer.echo(json.dumps([_record(x) for x in lines], indent=2, ensure_ascii=False))
    else:
        _show(console, lines, len(chosen), time.perf_counter() - started)
        if output is not None:
            console.print(f"Written to {output}", markup=False, highlight=False)
    if any(x.verdict == "FAIL" for x in lines):
        raise typer.Exit(1)


def _show(console: Console, lines: Sequence[Line], cases: int, spent: float) -> None:
    from rich.markup import escape
    from rich.table import Table

    table = Table(header_style="bold", box=None, pad_edge=False)
    for name in ("case", "quantity"):
        table.add_column(name, overflow="fold")
    for name in ("value", "trusted", "difference", "allowed", "s"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    before = ""
    for x in lines:
        table.add_row(
            escape(x.case) if x.case != before else "",
            escape(x.quantity) + (f" [dim]({escape(x.at)})[/]" if x.at else ""),
            _number(x.value, x.standard_error),
            _number(x.trusted),
            _number(x.difference, digits=2),
            _number(x.allowed, digits=2),
            f"{x.seconds:.2f}" if x.case != before else "",
            f"[{_COLOURS[x.verdict]}]{x.verdict}[/]",
        )
        before = x.case
    console.print(table)
    whats = {x.case: x.what for x in lines if x.verdict == "FAIL"}
    for x in lines:
        if x.verdict != "PASS" or x.note:
            console.print(
                f"{x.verdict} {x.criterion}: {x.note or whats.get(x.case, '')}", markup=False, highlight=False
            )
    counts = Counter(x.verdict for x in lines)
    told = ", ".join(f"{counts[v]} {v}" for v in ("PASS", "FAIL", "MISSING") if counts[v])
    console.print(f"{cases} cases, {len(lines)} checks: {told}; {spent:.0f} s.", highlight=False)


def _number(value: float, error: float = 0.0, digits: int = 7) -> str:
    if math.isnan(value):
        return "–"
    if error > 0:
        from livlab.criteria import format_with_error

        return format_with_error(value, error)
    return f"{value:.{digits}g}"


def _record(x: Line) -> dict[str, object]:
    numbers = {
        "value": x.value,
        "standard_error": x.standard_error,
        "trusted": x.trusted,
        "difference": x.difference,
        "allowed": x.allowed,
    }
    return {
        "case": x.case,
        "quantity": x.quantity,
        "what": x.what,
        "at": x.at,
        **{name: v if math.isfinite(v) else None for name, v in numbers.items()},
        "trusted_by": x.trusted_by,
        "seconds": x.seconds,
        "verdict": x.verdict,
        "note": x.note,
    }
