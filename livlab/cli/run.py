"""`livlab run`, `livlab schema`, `livlab report`."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from livlab.errors import ConfigError, Interrupted

if TYPE_CHECKING:
    from livlab.kinds.execute import Outcome

_COLOURS = {"PASS": "green", "FAIL": "bold red", "TOO CLOSE": "bold blue", "MISSING": "yellow"}


def register(app: typer.Typer) -> None:
    """Register the commands."""
    app.command("run")(run)
    app.command("schema")(schema)
    app.command("report")(report)


def run(
    files: Annotated[
        list[Path],
        typer.Argument(help="Experiment files (TOML), or names of livlab's own, e.g. spectral.", metavar="FILE..."),
    ],
    force: Annotated[bool, typer.Option("--force", help="Run again even if the result is there.")] = False,
    out: Annotated[Path, typer.Option("--out", help="Folder that holds the run folders.")] = Path("runs"),
    no_report: Annotated[bool, typer.Option("--no-report", help="Leave the report for later (livlab report).")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print only the report's path.")] = False,
    scheduler: Annotated[
        str,
        typer.Option(
            "--scheduler",
            help="Where the jobs of a study run: local, processes:N, or a Dask cluster's tcp://HOST:PORT.",
        ),
    ] = "local",
    store: Annotated[
        Path | None, typer.Option("--store", help="Folder of job results that several runs and users share.")
    ] = None,
) -> None:
    """Run experiments: simulate, measure, compare, report. What is done already is found, not done again."""
    from livlab.cli.progress import watched
    from livlab.config.kinds import KINDS
    from livlab.config.load import load_experiment
    from livlab.kinds.execute import execute

    experiments = [(file, load_experiment(file)) for file in files]
    if scheduler != "local":
        from livlab.jobs.scheduler import open_scheduler

        open_scheduler(scheduler)  # a slip is told before anything runs
    for file, experiment in experiments:
        has_jobs = KINDS[experiment.plain()["kind"]].jobs
        options = ["--out", str(out)] if out != Path("runs") else []
        if has_jobs:
            options += ["--scheduler", scheduler] if scheduler != "local" else []
            options += ["--store", str(store)] if store is not None else []
        elif not quiet and (scheduler != "local" or store is not None):
            told = f"{experiment.name} is no study, so --scheduler and --store change nothing: it runs here."
            Console(stderr=True).print(told, highlight=False, markup=False)
        command = shlex.join(["livlab", "run", str(file), *options])
        try:
            with watched(experiment.title or experiment.name, quiet=quiet) as progress:
                outcome = execute(
                    experiment,
                    base=out,
                    force=force,
                    command=command,
                    progress=progress,
                    report=not no_report,
                    scheduler=scheduler if has_jobs else "local",
                    shared=store,
                )
        except KeyboardInterrupt:
            raise Interrupted("Stopped.", remedy=f"To go on: {command}") from None
        except Interrupted as stopped:
            raise Interrupted(stopped.message, remedy=f"To go on: {command}") from None
        _show(outcome, quiet=quiet)


def schema(
    out: Annotated[Path | None, typer.Option("--out", help="Write it to a file instead.")] = None,
) -> None:
    """Print the JSON Schema of experiment files, for editors that complete and check as one types."""
    from livlab.config.load import json_schema
    from livlab.runs.files import write_whole

    text = json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"
    if out is None:
        typer.echo(text, nl=False)
    else:
        write_whole(out, text)
        typer.echo(out)


def report(
    folder: Annotated[Path, typer.Argument(help="A run folder, runs/NAME-DIGEST.", metavar="RUN")],
) -> None:
    """Build the report of a run folder again, from its files alone."""
    from livlab.kinds.report import rebuild_report
    from livlab.runs.identity import read_manifest

    if not folder.is_dir():
        raise ConfigError(f"{folder} is no run folder.", remedy="Name a folder that `livlab run` made.")
    if not read_manifest(folder):
        raise ConfigError(f"{folder} has no readable manifest.json.", remedy="Name a folder that `livlab run` made.")
    typer.echo(rebuild_report(folder))


def _show(outcome: Outcome, *, quiet: bool) -> None:
    if not quiet:
        console = Console()
        if outcome.claims:
            _print_claims(console, outcome.claims, _tissue(outcome.folder))
            _say_why(console, outcome)
        _say_misfit(console, outcome)
        _print_spread(console, outcome.folder)
        if outcome.cached:
            console.print("Done before; --force runs it again.", highlight=False)
    typer.echo(outcome.report or outcome.folder)


def _print_spread(console: Console, folder: Path) -> None:
    """Of a fit with alternatives, what the models say of each parameter beside its own interval."""
    import csv

    file = folder / "spread.csv"
    if not file.is_file():
        return
    with file.open(encoding="utf-8", newline="") as opened:
        rows = list(csv.DictReader(opened))
    for row in rows:
        own, over, values = (
            f"{float(row[a]):.4g} to {float(row[b]):.4g}" if row[a] and row[b] else "–"
            for a, b in (("lower", "upper"), ("weighted_lower", "weighted_upper"), ("least", "most"))
        )
        told = f"{row['parameter']}: {own} by its interval, {over} over {row['models']} models (values {values})"
        console.print(told, highlight=False, markup=False, soft_wrap=True)


def _tissue(folder: Path) -> str:
    """The organ that a run is about, as its claims of agreement call it."""
    from livlab.core.toml_text import parse_toml
    from livlab.criteria.limits import measured_tissue

    return measured_tissue(parse_toml((folder / "config.toml").read_text(encoding="utf-8")))


def _print_claims(console: Console, claims: list[dict[str, str]], tissue: str = "liver") -> None:
    """The claims by group, each under its heading with the number of each verdict."""
    from livlab.criteria import GROUPS, group_title
    from livlab.criteria.judging import verdict_counts
    from livlab.criteria.table import completed

    rows = completed(claims)
    groups = [(group, own) for group in GROUPS if (own := [c for c in rows if c["group"] == group])]
    tables = {group: _claims_table(own) for group, own in groups}
    endless = console.options.update(max_width=10_000)
    fits = all(console.measure(t, options=endless).maximum <= console.width for t in tables.values())
    for group, own in groups:
        told = ", ".join(f"{n} {verdict}" for verdict, n in verdict_counts(own))
        console.print(Text(f"{group_title(group, tissue)}: {told}", style="bold"), soft_wrap=True)
        if fits:
            console.print(tables[group])
        else:
            _print_lines(console, own)


def _claims_table(claims: list[dict[str, Any]]) -> Table:
    table = Table(title=None, header_style="bold")
    for column, justify in (("criterion", "left"), ("value ± error", "right"), ("wanted", "right"), ("", "left")):
        table.add_column(column, justify="right" if justify == "right" else "left", overflow="fold", no_wrap=True)
    for criterion, shown, wanted, verdict in map(_cells, claims):
        table.add_row(*map(escape, (criterion, shown, wanted)), Text(verdict, style=_COLOURS.get(verdict, "")))
    return table


def _print_lines(console: Console, claims: list[dict[str, Any]]) -> None:
    """Two lines a claim, where the terminal is too narrow for a table."""
    rows = [_cells(claim) for claim in claims]
    margin = max(len(verdict) for *_, verdict in rows) + 2
    for criterion, shown, wanted, verdict in rows:
        line = Text(verdict.ljust(margin), style=_COLOURS.get(verdict, ""))
        line.append(criterion, style="default")
        for text in (line, Text(f"{shown}  (wanted {wanted})")):
            console.print(Padding(text, (0, 0, 0, 0 if text is line else margin), expand=False), highlight=False)


def _say_why(console: Console, outcome: Outcome) -> None:
    """Why claims are MISSING, each reason once; and what would settle each that is TOO CLOSE."""
    from livlab.runs.identity import read_manifest

    notes = read_manifest(outcome.folder).get("claim_notes")
    known = notes if isinstance(notes, dict) else {}
    named = {v: [c["criterion"] for c in outcome.claims if c["verdict"] == v] for v in ("TOO CLOSE", "MISSING")}
    said = [f"TOO CLOSE: {name}: {known[name]}" for name in named["TOO CLOSE"] if name in known]
    said += dict.fromkeys(f"MISSING: {known[name]}" for name in named["MISSING"] if name in known)
    for line in said:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _say_misfit(console: Console, outcome: Outcome) -> None:
    """Whether a fit's model describes its data; nothing for runs that fit nothing."""
    from livlab.runs.identity import read_manifest

    found = read_manifest(outcome.folder).get("misfit")
    if isinstance(found, dict) and found.get("words"):
        style = _COLOURS.get("FAIL", "") if found.get("adequate") is False else ""
        console.print(Text(str(found["words"]), style=style), highlight=False, soft_wrap=True)


def _cells(claim: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Criterion, value with its error, what is wanted, verdict."""
    from livlab.criteria import format_value
    from livlab.criteria.limits import in_words

    names = ("value", "standard_error", "at_least", "at_most", "reference", "tolerance")
    value, error, *limits = (float(x) if (x := claim[k]) not in ("", None) else None for k in names)
    shown = format_value(value, error) + (f" ± {format_value(error, error)}" if error else "")
    return claim["criterion"], shown, in_words(*limits), claim["verdict"]
