"""A gallery: the pictures of several runs on one page, the older models beside them."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from livlab.core.files import write_whole
from livlab.core.picture_files import png_size
from livlab.errors import InputError
from livlab.kinds.picture.report import shown_pictures
from livlab.kinds.picture.report_words import alt_text, caption, findings, light_words
from livlab.machine.version import __version__
from livlab.reports.folder import RunData, read_run, sound
from livlab.reports.page import ICONS
from livlab.reports.tables import Image
from livlab.runs.files import told_plainly


@dataclass(frozen=True)
class GalleryEntry:
    """One run as the gallery shows it.

    Attributes
    ----------
    id, title, description
        Of the run.
    light
        How it was lit and exposed, in words.
    pictures, other_routes, baselines
        Its pictures by the first colour route, by the others, and the older models'.
    verdicts
        Number of claims by verdict.
    findings
        Sentences: colours in words, and what fails and why.
    report
        Relative path of its report, or nothing.
    """

    id: str
    title: str
    description: str
    light: str
    pictures: tuple[Image, ...]
    other_routes: tuple[Image, ...]
    baselines: tuple[Image, ...]
    verdicts: tuple[tuple[str, int], ...]
    findings: tuple[str, ...]
    report: str


def build_gallery(folders: Sequence[Path], out: Path) -> Path:
    """Write `index.html` and `images/` into a folder, from run folders alone; the page needs no network and no script.

    Parameters
    ----------
    folders
        Run folders of picture experiments, in the order they are to be shown.
    out
        Where the gallery goes; it is made if missing.

    Raises
    ------
    InputError
        No folder, one that is no picture run, or one without a finished picture.
    EnvironmentProblem
        The gallery cannot be written.
    """
    if not folders:
        raise InputError.of(
            "runs", [], "at least one run folder is needed", "Run an experiment first: livlab run FILE."
        )
    with told_plainly(out):
        (out / "images").mkdir(parents=True, exist_ok=True)
    entries, taken = [], Counter[str]()
    for folder in folders:
        run = read_run(folder)
        if str(run.manifest.get("kind")) != "picture":
            raise InputError.of("run", str(folder), "holds no pictures", "Name run folders of picture experiments.")
        name = re.sub(r"[^A-Za-z0-9_-]", "-", str(run.manifest.get("name", folder.name)))[:64]  # it names files
        taken[name] += 1
        with sound(run):
            entries.append(_entry(run, out, name if taken[name] == 1 else f"{name}-{taken[name]}"))
    environment = Environment(
        loader=PackageLoader("livlab.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    text = environment.get_template("gallery.html.j2").render(
        css=Markup(files("livlab.reports").joinpath("templates/style.css").read_text(encoding="utf-8")),
        entries=entries,
        icons=ICONS,
        version=__version__,
        pictures=sum(len(e.pictures) for e in entries),
    )
    write_whole(out / "index.html", text)
    return out / "index.html"


def _entry(run: RunData, out: Path, name: str) -> GalleryEntry:
    rows = shown_pictures(run)
    if not rows:
        raise InputError.of("run", str(run.path), "has no finished picture", "Finish it: livlab run FILE.")
    first = str(rows[0]["route"])
    counts = Counter(str(v) for v in run.claims["verdict"]) if len(run.claims) else Counter[str]()
    report = run.path / "report.html"
    return GalleryEntry(
        id=name,
        title=str(run.config.get("title") or name),
        description=str(run.config.get("description", "")).strip(),
        light=light_words(run),
        pictures=tuple(_copied(run, r, out, name) for r in rows if r["route"] == first),
        other_routes=tuple(_copied(run, r, out, name) for r in rows if r["route"] != first),
        baselines=tuple(_copied(run, r, out, name) for r in shown_pictures(run, baselines=True) if r["route"] == first),
        verdicts=tuple((v, counts[v]) for v in ICONS if counts[v]),
        findings=tuple(findings(run)),
        report=Path(os.path.relpath(report, out)).as_posix() if report.is_file() else "",
    )


def _copied(run: RunData, row: dict[str, Any], out: Path, name: str) -> Image:
    """A picture copied beside the page: a gallery stands on its own."""
    source = run.path / str(row["png"])  # `shown_pictures` has seen that it lies in the folder
    target = f"images/{name}-{source.name}"
    write_whole(out / target, source.read_bytes())
    return Image(target, alt_text(run, row), caption(run, row, lit_by=True), *png_size(source))
