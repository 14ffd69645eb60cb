"""`livlab brdf`: samples from photographs, models fitted to them, files converted, figures drawn."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from livlab.brdf.files.interface import HOLES
from livlab.brdf.files.registry import in_words, sources_in_words, written_suffixes
from livlab.cli.console import check_output, table_console
from livlab.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from rich.console import Console

    from livlab.acquire.photographs.error_budget import ErrorBudget
    from livlab.acquire.photographs.extract import Extracted
    from livlab.acquire.photographs.light_table import LightReport
    from livlab.acquire.photographs.rig import PhotographedRig
    from livlab.brdf.fit.loss import LossName

app = typer.Typer(no_args_is_help=True, help="BRDFs from photographs of spheres: extract, fit, compare, plot, convert.")

Loss = Annotated[str, typer.Option("--loss", help="cosine-weighted-l2, log, cube-root or chi2: it moves the answer.")]
DEFAULT_LOSS = "cosine-weighted-l2"

WIDTH = 160
"""Of tables that are not printed on a screen."""


def register(parent: typer.Typer) -> None:
    """Register the command."""
    parent.add_typer(app, name="brdf")


@app.command()
def extract(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="rig.toml, its folder, or a folder in DiLiGenT's layout.")],
    output: Annotated[Path, typer.Option("-o", "--output", help=f"{in_words()}.")],
    most: Annotated[int, typer.Option("--most", help="Samples that are kept at most.")] = 1_000_000,
    max_angle: Annotated[float, typer.Option("--max-angle", help="Largest angle from the normal, degrees.")] = 80.0,
    max_clipped: Annotated[
        float, typer.Option("--max-clipped", help="Share of a light's pixels that may clip.")
    ] = 0.02,
    skip_empty: Annotated[bool, typer.Option("--skip-empty", help="Leave out lights that give no sample.")] = False,
    budget: Annotated[
        str | None, typer.Option("--budget", metavar="MODEL", help="Fit this model, and print its error budget.")
    ] = None,
    loss: Loss = DEFAULT_LOSS,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Samples of a BRDF from photographs of a sphere; what is wrong or uncorrected is told."""
    from livlab.acquire.photographs.extract import extract_samples
    from livlab.acquire.photographs.open import open_rig
    from livlab.brdf.files.formats import write_brdf
    from livlab.brdf.models.model import model

    check_output(output, written_suffixes())
    if not 0 < max_angle < 90:
        raise InputError.of("--max-angle", max_angle, "must lie between 0 and 90 degrees", "Leave it out for 80.")
    if budget is not None:
        model(budget)  # a misspelt name must not cost an extraction
    photographs = open_rig(rig)
    console, follow = table_console(WIDTH), table_console(WIDTH, stderr=True)

    def progress(done: int, of: int) -> None:
        if follow.is_terminal:
            follow.print(f"light {done} of {of}", end="\r", highlight=False)

    found = extract_samples(
        photographs,
        most=most,
        max_angle=math.radians(max_angle),
        max_clipped=max_clipped,
        skip_empty=skip_empty,
        progress=progress,
    )
    parts = _budget(photographs, found.samples, budget, loss) if budget is not None else None
    write_brdf(output, found.samples)
    if as_json:
        typer.echo(json.dumps(_extracted(photographs, found, parts), indent=2, ensure_ascii=False))
        return
    _show_extracted(console, photographs, found)
    if parts is not None:
        _show_budget(console, parts)
    console.print(f"Written to {output}", markup=False, highlight=False)


@app.command()
def fit(
    samples: Annotated[Path, typer.Argument(metavar="FILE", help=f"Samples or a table: {in_words(last='')}.")],
    which: Annotated[str, typer.Argument(metavar="MODEL", help="Lobes joined by +: lambert+ggx.")],
    loss: Loss = DEFAULT_LOSS,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="JSON to write the fit to.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Fit a model, with intervals and what is to be mistrusted."""
    from livlab.brdf.fit import fit as fits
    from livlab.runs.files import write_whole

    if output is not None:
        check_output(output, (".json",))
    data = _samples(samples)
    found = fits.fit(data, which, loss=_loss(loss), warn=False)
    if output is not None:
        write_whole(output, found.to_json(indent=2) + "\n")
    typer.echo(found.to_json(indent=2) if as_json else found.summary())


@app.command()
def compare(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="One file and models, or several files.")],
    models: Annotated[list[str] | None, typer.Option("-m", "--model", help="A model to rank. Repeatable.")] = None,
    loss: Loss = DEFAULT_LOSS,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Rank models on one file and say which describe it to the noise, or compare files with the first one."""
    from livlab.brdf.fit import fit as fits
    from livlab.brdf.fit.result import adequate_in_words

    if len(files) == 1 and models:
        data = _samples(files[0])
        table, found = fits.compare(data, models, loss=_loss(loss), warn=False)
        if as_json:
            table = table.assign(
                misfit=[found[str(n)].misfit.words for n in table.index], noise_floor=table.attrs["noise_floor"]
            )
        _show_table(table.reset_index(), f"{len(models)} models on {files[0].name}, {loss}", as_json=as_json)
        for line in [] if as_json else adequate_in_words(found):
            typer.echo(line)
        return
    if len(files) < 2 or models:
        raise InputError.of(
            "files", f"{len(files)} files, {len(models or [])} models", "must be one file and models, or several files",
            "Rank models with -m lambert+ggx -m oren-nayar, or name two files.",
        )  # fmt: skip
    import pandas as pd

    from livlab.brdf.difference import difference
    from livlab.brdf.files.formats import read_brdf

    first = read_brdf(files[0])
    rows = [{"file": other.name, **difference(first, read_brdf(other))} for other in files[1:]]
    _show_table(pd.DataFrame(rows), f"against {files[0].name}", as_json=as_json)


@app.command()
def lights(
    rig: Annotated[Path, typer.Argument(metavar="FOLDER", help="As of extract; mirror balls alone are enough.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Where each light is and how strong: as given, by highlights, and as the shading of the sphere has it."""
    from livlab.acquire.photographs.light_table import light_table

    found = light_table(rig)
    if as_json:
        rows = json.loads(found.table.to_json(orient="records"))
        record = {"name": found.name, "lights": rows, "warnings": list(found.warnings), "notes": list(found.notes)}
        typer.echo(json.dumps(record, indent=2, ensure_ascii=False))
        return
    _show_lights(found)


@app.command()
def plot(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Samples or a table.")],
    output: Annotated[Path, typer.Option("-o", "--output", help=".png, .svg or .pdf.")],
    which: Annotated[str | None, typer.Option("-m", "--model", help="A model to fit, for residuals and lobes.")] = None,
    loss: Loss = DEFAULT_LOSS,
) -> None:
    """Draw the sphere with residuals, polar lobes, and cells with their holes."""
    from livlab.brdf.fit import fit as fits
    from livlab.reports.figures import style
    from livlab.reports.sphere_figures import lobes_of, sphere_figure
    from livlab.runs.files import write_whole

    check_output(output, (".png", ".svg", ".pdf"))
    data = _samples(file)
    title, predicted, lobes = file.name, None, None
    if which is not None:
        found = fits.fit(data, which, loss=_loss(loss), warn=False)
        predicted = found.predict(data).mean("channel").values
        lobes = lobes_of(found.evaluate)
        title = f"{file.name}: {found.model.name}, {found.relative_rmse:.2%} rms, {loss}"
    figure = sphere_figure(data, predicted, lobes, title)
    out = io.BytesIO()
    with style():
        figure.savefig(out, format=output.suffix[1:], dpi=130, facecolor="white")
    write_whole(output, out.getvalue())
    typer.echo(f"Written to {output}")


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(metavar="FROM", help=f"{sources_in_words()}.")],
    target: Annotated[Path, typer.Argument(metavar="TO", help=f"{in_words()}.")],
    holes: Annotated[
        str, typer.Option("--holes", help="refuse, fill (marked) or zero; of .binary and .bsdf.")
    ] = "refuse",
) -> None:
    """Convert between files of BRDFs; of a fit the model is written, which has no holes."""
    from livlab.brdf.files.formats import convert as converted

    check_output(target, written_suffixes())
    if holes not in HOLES:
        raise InputError.of("--holes", holes, "must be refuse, fill or zero", "Choose one.")
    converted(source, target, holes=holes)  # type: ignore[arg-type]
    typer.echo(f"Written to {target}")


def _loss(name: str) -> LossName:
    from livlab.brdf.fit.loss import LOSSES

    if name not in LOSSES:
        raise InputError.of("--loss", name, f"must be one of {', '.join(LOSSES)}", "Choose one.")
    return name  # type: ignore[return-value]


def _samples(path: Path) -> xr.Dataset:
    from livlab.brdf.files.formats import read_brdf
    from livlab.brdf.table import as_samples

    return as_samples(read_brdf(path))


def _show_extracted(console: Console, rig: PhotographedRig, found: Extracted) -> None:
    import numpy as np
    from rich.table import Table

    table = Table(header_style="bold", box=None, pad_edge=False)
    table.add_column("quantity")
    table.add_column("value")
    samples = found.samples
    lights = samples.sizes["light_index"]
    thinned = f", one pixel in {found.stride} x {found.stride}" if found.stride > 1 else ""
    near = sum(light.near for light in rig.lights)
    table.add_row("samples", f"{samples.sizes['sample']} of {lights} lights{thinned}")
    table.add_row("scale", str(samples.attrs["scale"]))
    if rig.pose is not None:
        (u, v, r), sd = rig.pose.circle_px, rig.pose.circle_sd_px
        where = f"({u:.2f}, {v:.2f}) px, radius {r:.2f} px; +- {sd[0]:.2f}, {sd[1]:.2f}, {sd[2]:.2f}"
        if not rig.camera.orthographic:
            where += f"; {rig.pose.sphere.radius_mm:g} mm, {np.linalg.norm(rig.pose.sphere.centre_mm):.4g} mm away"
        table.add_row("sphere", where)
        table.add_row("outline", rig.pose.told)
    if rig.highlights:
        worst = max(h.sd_rad for balls in rig.highlights for h in balls)
        table.add_row("light directions", f"from mirror balls, +- {np.rad2deg(worst):.2f} degrees at worst")
    table.add_row("lights", f"{near} near, {lights - near} distant")
    if found.lights is not None:
        table.add_row("one reflectance for all lights", found.lights.told)
    for name, verdict in (("exposure stack", rig.linearity), ("sphere", found.linearity)):
        if verdict is not None:
            table.add_row(f"linearity, {name}", verdict.told())
    if rig.calibration is not None:
        table.add_row("camera", f"{rig.calibration.residual_px:.2f} px residual, {rig.calibration.corners} corners")
    if rig.colour is not None:
        table.add_row("colour chart", f"{rig.colour.residual_before:.3f} to {rig.colour.residual:.3f} rms, white 1")
    table.add_row("noise", rig.noise_known)
    console.print(table)
    for text in rig.notes:
        console.print(f"note: {text}", markup=False, highlight=False)
    for text in found.unresolved:
        console.print(f"not corrected: {text}", markup=False, highlight=False)
    for text in found.warnings:
        console.print(f"warning: {text}", markup=False, highlight=False, style="yellow")


def _show_budget(console: Console, parts: ErrorBudget) -> None:
    from rich.markup import escape
    from rich.table import Table

    from livlab.acquire.photographs.error_budget import SOURCES

    table = Table(header_style="bold", box=None, pad_edge=False, title="Error budget: share of the variance, and sd")
    table.add_column("source")
    for name in parts.totals.index:
        table.add_column(escape(str(name)), justify="right")
    table.add_column("how")
    for source in SOURCES:
        rows = parts.table[parts.table["source"] == source].set_index("quantity")
        cells = [
            "-" if math.isnan(rows.loc[name, "sd"]) else f"{rows.loc[name, 'share']:.1%} ({rows.loc[name, 'sd']:.2g})"
            for name in parts.totals.index
        ]
        table.add_row(source, *cells, str(rows["how"].iloc[0]))
    table.add_row("value", *(f"{parts.totals.loc[name, 'value']:.5g}" for name in parts.totals.index), "")
    table.add_row("sd, all", *(f"{parts.totals.loc[name, 'sd']:.2g}" for name in parts.totals.index), "")
    shifts = [f"{parts.ignored_footprint[str(name)]:+.2g}" for name in parts.totals.index]
    table.add_row("if pixels were points", *shifts, "shift, not part of the sum")
    console.print(table)


def _extracted(rig: PhotographedRig, found: Extracted, parts: ErrorBudget | None) -> dict[str, object]:
    def number(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    record: dict[str, object] = {
        "name": rig.name,
        "samples": int(found.samples.sizes["sample"]),
        "lights": len(rig.lights),
        "scale": found.samples.attrs["scale"],
        "circle_px": None if rig.pose is None else list(rig.pose.circle_px),
        "circle_sd_px": None if rig.pose is None else list(rig.pose.circle_sd_px),
        "lights_residual": None if found.lights is None else number(found.lights.residual),
        "lights_noise": None if found.lights is None else number(found.lights.noise),
        "notes": list(rig.notes),
        "not_corrected": list(found.unresolved),
        "warnings": list(found.warnings),
    }
    for name, verdict in (("linearity_stack", rig.linearity), ("linearity_sphere", found.linearity)):
        if verdict is not None:
            record[name] = {
                "verdict": verdict.verdict, "gamma": number(verdict.gamma), "residual": number(verdict.residual),
                "residual_srgb": number(verdict.residual_srgb), "notes": list(verdict.notes),
            }  # fmt: skip
    if parts is not None:
        record["budget"] = json.loads(parts.table.to_json(orient="records"))
    return record


def _show_table(table: pd.DataFrame, title: str, *, as_json: bool) -> None:
    from rich.markup import escape
    from rich.table import Table

    if as_json:
        typer.echo(table.to_json(orient="records", indent=2))
        return
    shown = Table(header_style="bold", box=None, pad_edge=False, title=escape(title))
    for k, name in enumerate(table.columns):
        shown.add_column(escape(str(name)), justify="left" if k == 0 else "right")
    for row in table.itertuples(index=False):
        shown.add_row(*(f"{x:.5g}" if isinstance(x, float) else escape(str(x)) for x in row))
    table_console(WIDTH).print(shown)


def _show_lights(found: LightReport) -> None:
    from rich.table import Table

    heads = {
        "light": "light", "from_camera_deg": "from camera, deg", "around_deg": "round it, deg", "sd_deg": "+-",
        "highlight_deg": "highlight, deg", "highlight_around_deg": "round it, deg", "highlight_sd_deg": "+-",
        "apart_deg": "apart, deg", "shading_deg": "shading off, deg", "shading_sd_deg": "+-", "gain": "gain",
        "gain_sd": "+-", "residual": "residual", "clipped": "clipped", "clipped_highlight": "highlight clipped",
        "below_sr": "source below, sr", "verdict": "verdict",
    }  # fmt: skip
    shown = Table(header_style="bold", box=None, pad_edge=False, title=found.name)
    names = [name for name in heads if name in found.table and not found.table[name].isna().all()]
    for name in names:
        shown.add_column(heads[name], justify="left" if name == "verdict" else "right")
    for row in found.table.to_dict("records"):
        shown.add_row(*(_light_cell(name, row[name]) for name in names))
    console = table_console(WIDTH)
    console.print(shown)
    if found.check is not None:
        console.print(f"all together: {found.check.told}", markup=False, highlight=False)
    for text in found.notes:
        console.print(f"note: {text}", markup=False, highlight=False)
    for text in found.warnings:
        console.print(f"warning: {text}", markup=False, highlight=False, style="yellow")


def _light_cell(name: str, value: float | int | str) -> str:
    if not isinstance(value, float):
        return str(value)
    if math.isnan(value):
        return "-"
    if name in ("residual", "clipped", "clipped_highlight"):
        return f"{value:.1%}"
    return f"{value:.3f}" if name.startswith(("gain", "below")) else f"{value:.2f}"


def _budget(rig: PhotographedRig, samples: xr.Dataset, which: str, loss: str) -> ErrorBudget:
    from livlab.acquire.photographs.error_budget import error_budget, fitted

    evaluate, _ = fitted(samples, which, _loss(loss))
    return error_budget(rig, samples, evaluate)
