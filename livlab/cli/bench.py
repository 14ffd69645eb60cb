"""`livlab bench`: a page with sliders about the tissue of an experiment, from one recorded walk."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from livlab.errors import ConfigError

if TYPE_CHECKING:
    from livlab.kinds.spectral.config import SpectralExperiment


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("bench")(bench)


def bench(
    file: Annotated[
        Path, typer.Argument(help="A spectral experiment (TOML), or a run folder that has a bench.", metavar="FILE")
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The page; bench-NAME.html if not said.")] = None,
    reading: Annotated[
        str | None, typer.Option("--reading", help="Reading; the file's bench, or its last one, if not said.")
    ] = None,
    standard_error: Annotated[float, typer.Option(min=1e-6, max=0.1, help="Of the recorded walk.")] = 1e-3,
) -> None:
    """Write one page in which a tissue's values can be moved: curve, colour and errors follow at once, offline."""
    from livlab.reports.bench import read_bench, write_bench

    if file.is_dir():
        data = read_bench(file)
        if data is None:
            raise ConfigError(
                f"{file} has no bench.", remedy="Name an experiment file, or set `bench` in it and run it again."
            )
        name = file.name
    else:
        name, data = _recorded(file, reading, standard_error)
    page = write_bench(data, out or Path(f"bench-{name}.html"))
    typer.echo(page)


def _recorded(file: Path, wanted: str | None, standard_error: float) -> tuple[str, dict[str, Any]]:
    from livlab.cli.progress import watched
    from livlab.config.errors import nearest
    from livlab.config.load import load_experiment
    from livlab.kinds.spectral.config import SpectralExperiment
    from livlab.kinds.spectral.job import bench_of

    experiment = load_experiment(file)
    if not isinstance(experiment, SpectralExperiment):
        raise ConfigError(
            f"{file} is of kind {experiment.plain()['kind']}.",
            remedy="Name a spectral experiment, or the folder of a finished fit.",
        )
    chosen = _chosen(experiment, wanted)
    if chosen is None:
        names = [r.name for r in experiment.all_readings]
        hint = nearest(str(wanted), names) or f"Known: {', '.join(names)}."
        raise ConfigError(f"--reading = {wanted!r}: {file} has no such reading.", remedy=hint)
    with watched(f"bench of {experiment.name}", quiet=not Console(stderr=True).is_terminal) as progress:
        progress.begin(["walk"])
        data = bench_of(experiment, chosen, standard_error, lambda share: progress.advance("walk", min(share, 0.999)))
        progress.advance("walk", 1.0)
    return experiment.name, data


def _chosen(experiment: SpectralExperiment, wanted: str | None) -> str | None:
    names = [r.name for r in experiment.all_readings]
    if wanted is not None:
        return wanted if wanted in names else None
    return experiment.bench or names[-1]
