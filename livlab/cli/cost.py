"""`livlab cost`: error against time of every solver on an experiment's own scene."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from livlab.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

    from livlab.kinds.checks.cost import CostRow
    from livlab.kinds.spectral.config import SpectralExperiment


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("cost")(cost)


def cost(
    file: Annotated[Path, typer.Argument(help="An experiment file (TOML), or the name of one of livlab's own.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for cost.csv, .svg and .png; the experiment's run folder.")
    ] = None,
    budget: Annotated[float, typer.Option("--budget", help="Seconds to try for, about.", min=1.0)] = 60.0,
    reading: Annotated[str, typer.Option("--reading", help="Which reading; the first if not said.")] = "",
) -> None:
    """Say what accuracy costs on an experiment's scene: error against time of every solver and sample count."""
    from livlab.config.load import load_experiment
    from livlab.kinds.checks.cost import cost as study
    from livlab.kinds.spectral.config import SpectralExperiment
    from livlab.model.tissue.optics import optical_stack
    from livlab.reports.cost import sentence

    experiment = load_experiment(file)
    if not isinstance(experiment, SpectralExperiment):
        raise ConfigError(f"{file} is no spectral experiment.", remedy="Solvers are compared on plane layers.")
    readings = {r.name: r for r in experiment.all_readings}
    if reading and reading not in readings:
        raise ConfigError(f"{file} has no reading {reading!r}.", remedy=f"It has {', '.join(readings)}.")
    chosen = readings[reading] if reading else next(iter(readings.values()))
    folder = out or _run_folder(experiment)
    console = Console(stderr=True)
    stack = optical_stack(experiment.tissue.build(), chosen, experiment.wavelengths.grid())
    with console.status("") as status:
        rows = study(
            stack,
            experiment.instrument,
            budget_seconds=budget,
            seed=experiment.seed,
            variant=experiment.variant,
            say=lambda text: status.update(f"{chosen.name}: {text}"),
        )
    written = _write(folder, chosen.name, rows)
    shown = Console()
    shown.print(_table(chosen.name, rows))
    shown.print(sentence(_frame(chosen.name, rows)), highlight=False)
    typer.echo(written)


def _run_folder(experiment: SpectralExperiment) -> Path:
    from livlab.runs.identity import dataset_hashes, digest, folder_of

    resolved = experiment.resolve()
    return folder_of(resolved, digest(resolved, dataset_hashes(resolved.datasets())), Path("runs"))


def _write(folder: Path, reading: str, rows: list[CostRow]) -> Path:
    """The table, the figure twice, and the run's report anew if there is one."""
    from io import BytesIO

    from livlab.kinds.checks.cost import COLUMNS
    from livlab.kinds.report import rebuild_report
    from livlab.reports.cost import cost_figure
    from livlab.reports.figures import style, svg
    from livlab.runs.files import csv_text, open_folder, write_whole
    from livlab.runs.identity import read_manifest

    open_folder(folder.parent)
    open_folder(folder)
    write_whole(folder / "cost.csv", csv_text(("reading", *COLUMNS), [{"reading": reading, **asdict(r)} for r in rows]))
    figure = cost_figure(_frame(reading, rows))
    write_whole(folder / "cost.svg", '<?xml version="1.0" encoding="utf-8"?>\n' + svg(figure))
    with style():
        drawn = BytesIO()
        figure.savefig(drawn, format="png", dpi=150, facecolor="white")
    write_whole(folder / "cost.png", drawn.getvalue())
    if read_manifest(folder).get("status") == "complete":
        return rebuild_report(folder)
    return folder / "cost.svg"


def _frame(reading: str, rows: list[CostRow]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame([{"reading": reading, **asdict(r)} for r in rows])


def _table(reading: str, rows: list[CostRow]) -> Table:
    first = rows[0]
    about = f"{reading}: errors against {first.reference} (itself off by {first.reference_error:.1g})"
    table = Table(title=escape(about), title_justify="left", header_style="bold")
    for name in ("solver", "samples", "seconds", "error", "it states", ""):
        table.add_column(name, justify="left" if name in ("solver", "") else "right")
    for r in rows:
        marks = [*(["Pareto front"] if r.pareto else []), *([] if r.valid else ["outside its domain"])]
        table.add_row(
            r.solver,
            f"{r.samples:,}".replace(",", " ") if r.samples else "–",
            f"{r.seconds:.2g}" if r.seconds < 100 else f"{r.seconds:.0f}",
            f"{r.error:.1e}" if r.trusted else "–",
            f"{r.stated:.1e}" if r.stated == r.stated else "nothing",
            ", ".join(marks),
        )
    return table
