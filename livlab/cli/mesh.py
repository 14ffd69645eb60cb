"""`livlab mesh`: an outer and an inner surface from a segmentation, a mesh, or the liver made by code."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from livlab.core.files import missing_folder
from livlab.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from livlab.model.shapes import Inset, TriangleMesh

_FORMATS = ("ply", "obj", "stl")


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("mesh")(mesh)


def mesh(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="Segmentation (.nii, .nii.gz, .nrrd, .npy, .npz, a folder of PNG or TIFF slices), mesh (.ply, .obj, "
            ".stl), or the word liver.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="NAME or NAME.ply: writes NAME-outer.ply and NAME-inner.ply.")
    ] = None,
    thickness: Annotated[float, typer.Option(help="Thickness of the shell (the capsule) in mm.")] = 0.1,
    how: Annotated[str, typer.Option(help="How the inner surface is made: distance, normal or scale.")] = "distance",
    unit: Annotated[str, typer.Option(help="Unit of a mesh file: mm, cm, m, um or inch.")] = "mm",
    label: Annotated[int | None, typer.Option(help="Label of the voxels inside; all but 0 unless said.")] = None,
    threshold: Annotated[float | None, typer.Option(help="Grey values above this are inside.")] = None,
    spacing: Annotated[str | None, typer.Option(help="Voxel edges x,y,z in mm, or one for all.")] = None,
    smoothing: Annotated[
        float | None, typer.Option(help="Blur of a segmentation in mm; 0.7 of the longest voxel edge unless said.")
    ] = None,
    faces: Annotated[int | None, typer.Option(help="Most faces of the outer mesh; more are thinned out.")] = None,
    keep: Annotated[str, typer.Option(help="Separate parts of a segmentation: largest or all.")] = "largest",
    size: Annotated[float, typer.Option(help="Extent of the liver made by code, in mm.")] = 140.0,
    form: Annotated[str, typer.Option("--format", help="ply, obj or stl, where --out does not say.")] = "ply",
    force: Annotated[bool, typer.Option("--force", help="Overwrite.")] = False,
) -> None:
    """Make a closed outer mesh and the inner one under its capsule, and say what came of it.

    A mesh that does not bound a solid is refused with the place and a remedy. Both files are written whole, or none.
    """
    from rich.console import Console

    from livlab.model.shapes import check, inset, write_meshes

    started = time.perf_counter()
    targets = _targets(file, out, form, force)
    outer, notes = _outer(
        file, unit=unit, label=label, threshold=threshold, spacing=spacing, smoothing=smoothing, faces=faces, keep=keep,
        size=size,
    )  # fmt: skip
    if how not in ("distance", "normal", "scale"):
        raise InputError.of("how", how, "must be distance, normal or scale", "Take distance.")
    notes += check(outer)
    shell = inset(outer, thickness, how)  # type: ignore[arg-type]
    notes += shell.warnings
    write_meshes(dict(zip(targets, (outer, shell.mesh), strict=True)))
    console = Console()
    console.print(_table(outer, shell, thickness, time.perf_counter() - started))
    for note in notes:
        Console(stderr=True).print(f"note: {note}", style="yellow", markup=False, highlight=False)
    for path in targets:
        console.print(f"Written to {path}", markup=False, highlight=False, soft_wrap=True)


def _targets(file: str, out: Path | None, form: str, force: bool) -> tuple[Path, Path]:
    if form not in _FORMATS:
        raise InputError.of("format", form, f"must be one of {', '.join(_FORMATS)}", "Take ply.")
    suffix = f".{form}"
    stem = out if out is not None else Path(Path(file).name.split(".")[0])
    if stem.suffix.lower()[1:] in _FORMATS:
        stem, suffix = stem.with_suffix(""), stem.suffix.lower()
    if not stem.parent.is_dir():
        raise InputError.of("out", str(out), f"has no folder {stem.parent}", missing_folder(stem.parent))
    found = tuple(stem.with_name(f"{stem.name}-{which}{suffix}") for which in ("outer", "inner"))
    for path in found:
        if path.exists() and not force:
            raise InputError.of("out", str(path), "exists already", "Name another with --out, or say --force.")
    return found[0], found[1]


def _outer(
    file: str,
    *,
    unit: str,
    label: int | None,
    threshold: float | None,
    spacing: str | None,
    smoothing: float | None,
    faces: int | None,
    keep: str,
    size: float,
) -> tuple[TriangleMesh, list[str]]:
    from livlab.model.shapes import liver, read_mesh, read_volume, surface
    from livlab.model.shapes.volume_files import is_volume

    path = Path(file)
    if is_volume(path) or label is not None or threshold is not None or spacing is not None:
        segmentation = read_volume(
            path, spacing_mm=_lengths(spacing) if spacing else None, label=label, threshold=threshold
        )
        made = surface(segmentation, smoothing_mm=smoothing, faces=faces, keep=keep)
        return made.mesh, list(made.notes)
    if smoothing is not None:
        raise InputError.of("smoothing", smoothing, "is for segmentations", "Smooth a mesh where it was made.")
    outer = liver(size) if file == "liver" and not path.exists() else read_mesh(path, unit=unit)
    if faces is None or len(outer.faces) <= faces:
        return outer, []
    from livlab.model.shapes import check
    from livlab.model.shapes.solids import thinned

    check(outer)
    thin, tolerance = thinned(outer, faces)
    said = f"Thinned from {len(outer.faces):,} faces to {len(thin.faces):,}"
    return thin, [f"{said}; the surface moved by at most {tolerance:.3g} mm."]


def _lengths(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError.of("spacing", text, "must be one or three numbers", "Write 0.7,0.7,1.5, say.") from None


def _table(outer: TriangleMesh, shell: Inset, thickness: float, seconds: float) -> Table:
    from rich.table import Table

    made = Table("", "outer", "inner", title="Meshes", title_justify="left")
    both = (outer, shell.mesh)
    made.add_row("faces", *(f"{len(m.faces):,}" for m in both))
    made.add_row("vertices", *(f"{len(m.vertices):,}" for m in both))
    made.add_row("extent / mm", *(" × ".join(f"{x:.5g}" for x in m.extent) for m in both))
    made.add_row("volume / mm³", *(f"{m.volume:.6g}" for m in both))
    made.add_row("area / mm²", *(f"{m.area:.6g}" for m in both))
    made.add_row("watertight", "yes", "yes")  # refused otherwise
    made.add_row(
        "shell to the other / mm",
        *(_spread(t.minimum_mm, t.median_mm, t.maximum_mm) for t in (shell.thickness, shell.depth)),
    )
    made.add_row(
        f"off {thickness:g} mm by over 10 %",
        *(f"{100 * t.outside_share:.3g} % of area" for t in (shell.thickness, shell.depth)),
    )
    made.caption = f"Shell: least, median, most. {seconds:.1f} s."
    made.caption_justify = "left"
    return made


def _spread(*values: float) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
