"""`livlab gallery`: the pictures of several runs on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from livlab.errors import ConfigError


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command("gallery")(gallery)


def gallery(
    runs: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Run folders of picture experiments; every finished one under runs/ if none.", metavar="RUN..."
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for the page and its pictures.")] = Path("gallery"),
    base: Annotated[Path, typer.Option("--runs", help="Folder that is searched if no run is named.")] = Path("runs"),
    small: Annotated[
        int | None,
        typer.Option("--small", help="No page: only the pictures, made so many pixels wide.", metavar="WIDTH"),
    ] = None,
    table: Annotated[bool, typer.Option("--table", help="No page: print the pictures' numbers as a table.")] = False,
) -> None:
    """Put the pictures of several runs on one page that needs no network."""
    from livlab.kinds.picture.gallery import build_gallery

    folders = list(runs) if runs else finished(base)
    if not folders:
        raise ConfigError(
            f"{base} holds no finished picture.", remedy="Make some: livlab run experiments/liver-*.toml, or name runs."
        )
    if table:
        from livlab.kinds.picture.gallery_table import picture_table

        typer.echo(picture_table(folders))
        return
    if small is None:
        typer.echo(build_gallery(folders, out))
        return
    from livlab.kinds.picture.gallery_small import small_copies

    for path in small_copies(folders, out, small):
        typer.echo(path)


def finished(base: Path) -> list[Path]:
    """Complete picture runs under a folder, by name; of several of one name the latest."""
    from livlab.runs.identity import read_manifest

    latest: dict[str, tuple[str, Path]] = {}
    for folder in sorted(base.iterdir()) if base.is_dir() else []:
        manifest = read_manifest(folder)
        if manifest.get("kind") != "picture" or manifest.get("status") != "complete":
            continue
        name, when = str(manifest.get("name")), str(manifest.get("finished"))
        if name not in latest or when > latest[name][0]:
            latest[name] = (when, folder)
    return [folder for _, folder in (latest[name] for name in sorted(latest))]
