"""Parts that several of the dossier's pages share: figures and pictures of a run, and grids of claims."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from livlab.core.files import write_whole
from livlab.core.picture_files import png_size
from livlab.criteria import GROUPS, VERDICTS, group_title
from livlab.dossier.site import MISSING, CellGrid, GridCell, SiteEntry
from livlab.kinds.picture.report import shown_pictures
from livlab.kinds.picture.report_words import alt_text, caption
from livlab.reports.figures import drawn_by_livlab, inline
from livlab.reports.tables import Image, Images, Picture, Text, number


def shown_figures(entry: SiteEntry, captions: Mapping[str, str], page: str) -> list[Any]:
    """Figures of a run, inlined; one that is not there is told, not left out."""
    content: list[Any] = []
    for name, words in captions.items():
        if entry.run is None:
            continue
        file = entry.run.path / "figures" / f"{name}.svg"
        try:
            text = file.read_text(encoding="utf-8")
        except OSError:
            content.append(Text(f"{MISSING}: the run {entry.name} has no figure {name}."))
            continue
        svg = drawn_by_livlab(text)
        if svg is None:
            content.append(Text(f"{MISSING}: figure {name} of the run {entry.name} is not as livlab draws figures."))
            continue
        content.append(Picture(Markup(inline(svg, f"{page}-{entry.name}-{name}", words)), words))
    return content


def copied_pictures(entry: SiteEntry, out: Path) -> list[Any]:
    """A picture run's pictures by its first colour route, copied into the site, and the older models' beside them."""
    if entry.run is None:
        return []
    content: list[Any] = []
    for baselines, words in ((False, ""), (True, "Older models in the same light.")):
        rows = shown_pictures(entry.run, baselines=baselines)
        items = tuple(_copied(entry, r, out) for r in rows if r["route"] == rows[0]["route"])
        if items:
            content.append(Images(items, words, large=len(items) == 1))
        elif not baselines:
            content.append(Text(f"{MISSING}: the run {entry.name} has no finished picture."))
    return content


def sheets(entry: SiteEntry, out: Path) -> list[Any]:
    """What a BRDF run photographed: its spheres under each light."""
    if entry.run is None or entry.kind != "brdf":
        return []
    items = []
    for row in entry.run.table("pictures").to_dict("records"):
        source = entry.run.path / str(row["png"])
        if source.is_file():
            subject = str(row.get("material") or row.get("reading"))
            target = _copy(source, out, entry.name)
            words = f"{subject}: the sphere under each light"
            items.append(Image(target, words, words, *png_size(source)))
    return [Images(tuple(items))] if items else []


def experiments_grid(entries: Iterable[SiteEntry], words: str) -> CellGrid:
    """One row an experiment."""
    rows = []
    for e in entries:
        counts = dict(e.counts)
        rows.append(
            (
                GridCell(e.title, e.report, note="" if e.run is not None else f"{e.state}: {e.reason}"),
                GridCell(e.name),
                *(GridCell(str(counts.get(v, "")) if e.run is not None or v == MISSING else "") for v in _VERDICTS),
                GridCell(number(e.seconds, 3) if e.run is not None else "–"),
            )
        )
    return CellGrid(words, ("experiment", "name", *_VERDICTS, "seconds"), tuple(rows), (*_VERDICTS, "seconds"))


def claims_grid(found: Iterable[tuple[SiteEntry, Mapping[str, str]]], words: str) -> CellGrid:
    """One row a claim, with the experiment that makes it."""
    rows = [
        (
            GridCell(c["criterion"], note=c["reason"]),
            GridCell(verdict=c["verdict"]),
            GridCell(e.name, e.report or f"{e.group}.html#{e.name}"),
            GridCell(c["value"]),
            GridCell(c["wanted"]),
            GridCell(c["seconds"]),
        )
        for e, c in found
    ]
    columns = ("claim", "verdict", "experiment", "value ± error", "wanted", "seconds")
    return CellGrid(words, columns, tuple(rows), columns[3:])


def groups_grid(entries: Iterable[SiteEntry]) -> CellGrid:
    """One row for what claims are held against: the thesis, each organ that was measured, livlab itself."""
    found: dict[str, Counter[str]] = {}
    unknown: Counter[str] = Counter()
    told = [(e, row) for e in entries for row in e.rows]
    for group in GROUPS:
        for e, row in told:
            if row["group"] == group:
                found.setdefault(group_title(group, e.tissue), Counter())[row["verdict"]] += 1
    unknown.update(row["verdict"] for _, row in told if row["group"] not in GROUPS)
    if unknown:
        found["Of experiments without a result"] = unknown
    rows = [(GridCell(t), *(GridCell(str(n[v] or "")) for v in VERDICTS)) for t, n in found.items()]
    words = (
        "Two questions have two answers: whether a figure of the thesis comes out again (a limit on both sides), and "
    )
    words += "how near to a measurement it is (a limit on one side, since less error is never too little)."
    return CellGrid(words, ("", *VERDICTS), tuple(rows), VERDICTS)


def _copied(entry: SiteEntry, row: Mapping[str, Any], out: Path) -> Image:
    assert entry.run is not None
    source = entry.run.path / str(row["png"])
    words = dict(row)
    return Image(
        _copy(source, out, entry.name), alt_text(entry.run, words), caption(entry.run, words), *png_size(source)
    )


def _copy(source: Path, out: Path, name: str) -> str:
    target = f"images/{name}-{source.name}"
    (out / "images").mkdir(exist_ok=True)
    write_whole(out / target, source.read_bytes())
    return target


_VERDICTS = VERDICTS
