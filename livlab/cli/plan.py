"""`livlab plan`: which effects an experiment's scenes call for, and what leaving the others out saves."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from livlab.errors import ConfigError

if TYPE_CHECKING:
    from livlab.effects.plan import Plan

_COLOURS = {"dropped": "green", "forced off": "yellow", "forced on": "yellow", "–": "dim"}


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("plan")(plan)


def plan(
    file: Annotated[Path, typer.Argument(help="An experiment file (TOML).", metavar="FILE")],
    tolerance: Annotated[
        float | None, typer.Option(help="How far the instrument's value may move; the file's, or 0.002, if not said.")
    ] = None,
    measure: Annotated[
        bool, typer.Option("--measure", help="Also time walks with and without what is dropped.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say which effects an experiment's scenes call for: what each changes at most, and what leaving it out saves."""
    from livlab.config.load import load_experiment
    from livlab.kinds.spectral.config import SpectralExperiment

    experiment = load_experiment(file)
    if not isinstance(experiment, SpectralExperiment):
        raise ConfigError(f"{file} is no spectral experiment.", remedy="A plan needs plane layers under an instrument.")
    plans = _plans(experiment, tolerance)
    if measure:
        from livlab.effects.timing import measured

        plans = {name: measured(made, variant=experiment.variant) for name, made in plans.items()}
    if as_json:
        typer.echo(json.dumps({name: _json(made) for name, made in plans.items()}, indent=2, ensure_ascii=False))
        return
    console = Console()
    for name, made in plans.items():
        console.print(_table(name, made))
        console.print(_sentence(made), highlight=False)


def _plans(experiment: object, tolerance: float | None) -> dict[str, Plan]:
    """One plan a reading."""
    from livlab.effects.config import EffectsConfig
    from livlab.effects.plan import plan as make
    from livlab.kinds.spectral.config import SpectralExperiment
    from livlab.model.tissue.optics import optical_stack

    assert isinstance(experiment, SpectralExperiment)
    # What the file says of effects rules, but a plan is made even for a run that simulates all of them.
    effects = getattr(experiment, "effects", None) or EffectsConfig(mode="auto")
    tissue, grid = experiment.tissue.build(), experiment.wavelengths.grid()
    literal = getattr(experiment.solver, "estimator", "expected") == "analog"
    return {
        reading.name: make(
            optical_stack(tissue, reading, grid),
            experiment.instrument,
            effects.tolerance if tolerance is None else tolerance,
            effects.forced,
            tolerance_of=effects.tolerance_of,
            tissue=tissue,
            reading=reading,
            literal=literal,
        )
        for reading in experiment.all_readings
    }


def _json(made: Plan) -> dict[str, object]:
    table = made.table().astype(object)
    return {
        "tolerance": made.tolerance,
        "bound": None if math.isnan(made.bound) else made.bound,
        "dropped": list(made.dropped),
        "effects": table.where(table.notna(), None).to_dict(orient="records"),
    }


def _table(name: str, made: Plan) -> Table:
    timed = made.measured_saving is not None
    title = f"{name}: tolerance {made.tolerance:.3g}"
    table = Table(title=escape(title), title_justify="left", header_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("effect", no_wrap=True)
    for column in ("changes ≤", "saves", *(("measured",) if timed else ())):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("why", overflow="fold")
    for record in made.records():
        decision = str(record["decision"]).replace("not applicable", "–")
        cells = [_number(record["bound"]), _percent(record["predicted_saving"])]
        cells += [_percent(record["measured_saving"])] if timed else []
        colour = _COLOURS.get(decision, "")
        shown = f"[{colour}]{decision}[/]" if colour else decision
        table.add_row(str(record["effect"]), *cells, shown, str(record["why"]))
    return table


def _sentence(made: Plan) -> str:
    if not made.dropped:
        return "Nothing is left out."
    text = f"Left out: {', '.join(made.dropped)}. The value moves by at most {made.bound:.2g}."
    if made.measured_saving is None:
        return f"{text} About {1 / (1 - made.predicted_saving):.1f} times faster (predicted)."
    return f"{text} {1 / (1 - made.measured_saving):.1f} times faster (measured, time for equal standard error)."


def _number(value: object) -> str:
    return "–" if not isinstance(value, float) or math.isnan(value) else f"{value:.2g}"


def _percent(value: object) -> str:
    return "–" if not isinstance(value, float) or math.isnan(value) else f"{100 * value:.0f} %"
