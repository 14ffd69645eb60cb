"""`livlab fractions`: collagen and elastin from two-colour micrographs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from livlab.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from livlab.acquire.micrographs.fractions import LayerTable, PageFractions


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("fractions")(fractions)


def fractions(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="PNG, JPEG or TIFF, also TIFF stacks.")],
    channel: Annotated[
        list[str] | None,
        typer.Option(help="elastin=green and collagen=magenta unless said; also red, blue, or a number. Repeatable."),
    ] = None,
    threshold: Annotated[str, typer.Option(help="In 255ths of full scale, or otsu.")] = "10",
    roi: Annotated[str | None, typer.Option(help="Region of interest x,y,w,h in pixels.")] = None,
    stack: Annotated[str | None, typer.Option(help="Depth of each page in µm: 0,10,25 or START:STEP.")] = None,
    layers: Annotated[str | None, typer.Option(help="Edges of the sublayers in % of thickness: 0,65,72,100.")] = None,
    thickness_um: Annotated[float | None, typer.Option(help="Thickness of the layer in µm.")] = None,
    full_scale: Annotated[float | None, typer.Option(help="Value of a full pixel: 4095 for 12 bits in 16.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Table to write: .csv or .toml.")] = None,
) -> None:
    """Measure the volume fractions of collagen and elastin on two-colour micrographs.

    A pixel above both thresholds counts in both. Errors are counting errors, one standard error.
    """
    from rich.console import Console

    from livlab.acquire.micrographs.fractions import Method, Roi, layer_table, measure_files
    from livlab.acquire.micrographs.table import write_table

    if output is not None and output.suffix not in (".csv", ".toml"):
        raise InputError.of("output", str(output), "must end in .csv or .toml", "Name it so.")
    method = Method(
        channels={"elastin": "green", "collagen": "magenta"} | dict(_pair(text) for text in channel or []),
        threshold="otsu" if threshold == "otsu" else _number("threshold", threshold),
        roi=Roi.parse(roi) if roi else None,
        full_scale=full_scale,
    )
    pages = list(measure_files(images, method))
    console = Console()
    console.print(_pages_table(pages))
    for page in pages:
        for note in page.warnings:
            Console(stderr=True).print(f"{page.source}, page {page.number}: {note}", style="yellow", markup=False)
    if len(pages) > 1 and stack is None and layers is None and output is None:
        return
    table = layer_table(
        pages,
        depths_um=_depths(stack, len(pages)) if stack else None,
        thickness_um=thickness_um,
        edges=[_number("layers", x) / 100 for x in layers.split(",")] if layers else None,
    )
    console.print(_layers_table(table))
    if output is not None:
        write_table(output, table)
        console.print(f"Written to {output}", markup=False)


def _pages_table(pages: list[PageFractions]) -> Table:
    from rich.table import Table

    from livlab.criteria import format_with_error

    made = Table("image", "page", "elastin", "collagen", "both", "threshold", "± 20 % of threshold", "pixels")
    for page in pages:
        made.add_row(
            escape(page.source),
            str(page.number),
            format_with_error(page.elastin.value, page.elastin.standard_error),
            format_with_error(page.collagen.value, page.collagen.standard_error),
            f"{page.overlap:.3f}",
            f"{page.elastin.threshold:.3g} / {page.collagen.threshold:.3g}",
            f"{page.elastin.threshold_effect:.3f} / {page.collagen.threshold_effect:.3f}",
            str(page.pixels),
        )
    return made


def _layers_table(table: LayerTable) -> Table:
    from rich.table import Table

    from livlab.criteria import format_with_error

    made = Table("share of thickness", "elastin", "collagen")
    for k in range(len(table.elastin)):
        made.add_row(
            f"{100 * table.edges[k]:.4g}–{100 * table.edges[k + 1]:.4g} %",
            format_with_error(float(table.elastin[k]), float(table.elastin_error[k])),
            format_with_error(float(table.collagen[k]), float(table.collagen_error[k])),
        )
    return made


def _pair(text: str) -> tuple[str, str]:
    element, _, colour = text.partition("=")
    if element not in ("elastin", "collagen") or not colour:
        raise InputError.of("channel", text, "must be elastin=COLOUR or collagen=COLOUR", "Give elastin=green, say.")
    return element, colour


def _depths(text: str, pages: int) -> list[float]:
    if ":" in text:
        start, _, step = text.partition(":")
        return [_number("stack", start) + k * _number("stack", step) for k in range(pages)]
    return [_number("stack", part) for part in text.split(",")]


def _number(field: str, text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise InputError.of(field, text, "must be a number", "See livlab fractions --help.") from error
