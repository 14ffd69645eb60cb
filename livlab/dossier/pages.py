"""The dossier's pages: the index, a page for each group of experiments, and the thesis beside ours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from livlab.criteria import VERDICTS, group_title
from livlab.dossier.parts import claims_grid, copied_pictures, experiments_grid, groups_grid, sheets, shown_figures
from livlab.dossier.site import MISSING, CellGrid, GridCell, Site, SiteEntry
from livlab.dossier.sure_words import spelt, sure_words
from livlab.dossier.thesis import answered, thesis_parts
from livlab.kinds.picture.report_words import findings
from livlab.reports.tables import Text, number

REST = "rest"


@dataclass(frozen=True)
class PagePart:
    """A section of a page.

    Attributes
    ----------
    counts, verdict
        Verdicts shown beside its heading: numbers of them, or one.
    notice
        What is wrong with it, shown apart.
    lead, link
        Where more is: text and address.
    left, content, after
        What stands on the left (of the thesis), on the right or alone, and beneath both.
    """

    id: str
    title: str
    content: tuple[Any, ...] = ()
    counts: tuple[tuple[str, int], ...] = ()
    notice: str = ""
    lead: str = ""
    link: str = ""
    left: tuple[Any, ...] = ()
    after: tuple[Any, ...] = ()
    verdict: str = ""


@dataclass(frozen=True)
class Page:
    """A page of the site."""

    name: str
    short: str
    title: str
    text: str
    parts: tuple[PagePart, ...]
    counts: tuple[tuple[str, int], ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
    notices: tuple[str, ...] = ()


def index_page(site: Site, pages: Sequence[Page]) -> Page:
    """Every claim, what fails and what is missing, what every experiment costs, and where the rest is."""
    counts: Counter[str] = Counter()
    for e in site.entries:
        counts.update(dict(e.counts))
    bad = [
        (e, c)
        for verdict in ("FAIL", "TOO CLOSE", MISSING)
        for e in site.entries
        for c in e.rows
        if c["verdict"] == verdict
    ]
    silent = [e for e in site.entries if e.run is None and not e.rows]
    trouble: list[Any] = []
    if bad:
        trouble.append(
            claims_grid(
                bad,
                "Claims that fail, those too close to their limit, and those that cannot be judged, each with why.",
            )
        )
    trouble += [
        Text(f"{MISSING}: {e.name} has no result, so that none of its claims is known: {e.reason}.") for e in silent
    ]
    if not trouble:
        trouble.append(Text("Every claim holds, and none is missing."))
    every = [PagePart("experiments", "Experiments", (experiments_grid(site.entries, _COST),))]
    return Page(
        "index",
        "Claims",
        str(site.dossier["title"]),
        str(site.dossier["description"]).strip(),
        (
            PagePart("groups", "What is claimed, by what it is held against", (groups_grid(site.entries),)),
            PagePart("trouble", "What fails, is too close, or is missing", tuple(trouble)),
            PagePart("sure", "How sure the verdicts are together", sure_words(site)),
            *every,
            PagePart(
                "thesis", "The thesis's figures and tables", (_answers(site),), link="thesis.html", lead="All of them"
            ),
            *_every_claim(site),
            _baseline(site),
        ),
        tuple((v, counts[v]) for v in VERDICTS if counts[v]),
        _facts(site),
        _notices(site),
    )


_COST = "What each experiment claims, and the seconds it took when it ran. The name leads to its own report."


def thesis_page(site: Site) -> Page:
    """The thesis's figures and tables, each beside ours."""
    parts = []
    for answer in site.dossier["answer"]:
        missing, left, right, after = thesis_parts(site, answer)
        parts.append(
            PagePart(
                str(answer["id"]),
                f"{answer['name']}: {answer['title']}",
                tuple(right),
                notice=missing,
                left=tuple(left),
                after=tuple(after),
                verdict=MISSING if missing else "",
            )
        )
    return Page(
        "thesis",
        "Thesis",
        "The thesis's figures and tables, beside ours",
        "On the left what A. L. P. Nunes (doctoral thesis, UFRGS 2019, in Portuguese) shows, in words: its pictures "
        "are not ours to copy, its numbers are. On the right what came out here. Beneath, both numbers, and why they "
        "differ.",
        tuple(parts),
    )


def group_pages(site: Site) -> list[Page]:
    """A page for each group of the dossier's file, and one for experiments that it does not list."""
    pages = []
    texts = {str(e["name"]): e for g in site.dossier["group"] for e in g["experiment"]}
    for group in site.dossier["group"]:
        entries = [e for e in site.entries if e.group == group["id"]]
        parts = [_experiment(site, e, texts.get(e.name, {}), str(group["id"])) for e in entries]
        if group["effects"]:
            parts.append(_left_out(site))
        pages.append(_grouped(group, entries, parts))
    rest = [e for e in site.entries if e.group == REST]
    if rest:
        parts = [_experiment(site, e, {}, REST) for e in rest]
        words = "Experiments of the folder that the dossier's file does not list."
        other = {"id": REST, "short": "Other", "title": "Other experiments", "text": words}
        pages.append(_grouped(other, rest, parts))
    return pages


def _grouped(group: Mapping[str, Any], entries: Sequence[SiteEntry], parts: Sequence[PagePart]) -> Page:
    counts: Counter[str] = Counter()
    for e in entries:
        counts.update(dict(e.counts))
    shown = tuple((v, counts[v]) for v in VERDICTS if counts[v])
    title, text = str(group["title"]), str(group["text"]).strip()
    return Page(str(group["id"]), str(group["short"] or title), title, text, tuple(parts), shown)


def _experiment(site: Site, e: SiteEntry, said: Mapping[str, Any], page: str) -> PagePart:
    content: list[Any] = [Text(e.description)] if e.description else []
    if said.get("text"):
        content.append(Text(str(said["text"]).strip()))
    if e.run is not None:
        if e.kind == "picture":
            content += [*copied_pictures(e, site.out), *(Text(t) for t in findings(e.run))]
        content += sheets(e, site.out)
        content += shown_figures(e, said.get("figures", {}), page)
        for note in e.run.manifest.get("notes", []):
            content.append(Text(f"Note: {note}"))
    content.append(_claims(e))
    return PagePart(
        e.name,
        e.title,
        tuple(content),
        e.counts if e.rows or e.run is None else (),
        "" if e.run is not None else f"{MISSING}: {e.reason}",
        "The whole report" + (f" · took {number(e.seconds, 3)} s" if e.run is not None else ""),
        e.report,
    )


def _claims(e: SiteEntry) -> Any:
    if not e.rows:
        return Text("It makes no claims." if e.run is not None else "Its claims are not known.")
    columns = ("claim", "verdict", "value ± error", "wanted", "held against", "seconds")
    rows = tuple(
        (
            GridCell(c["criterion"], note=c["reason"]),
            GridCell(verdict=c["verdict"]),
            *(GridCell(c[k]) for k in ("value", "wanted")),
            GridCell(group_title(c["group"], e.tissue) if c["group"] else ""),
            GridCell(c["seconds"]),
        )
        for c in e.rows
    )
    return CellGrid(
        f"Claims of {e.name}.", columns, rows, ("value ± error", "wanted", "seconds"), f"Its {len(rows)} claims"
    )


def _every_claim(site: Site) -> list[PagePart]:
    """Every claim by group, each experiment's behind a line that counts them; on paper they stand open."""
    titles = {str(g["id"]): str(g["title"]) for g in site.dossier["group"]} | {REST: "Other experiments"}
    content: list[Any] = []
    for group, title in titles.items():
        for e in site.entries:
            if e.group == group and e.rows:
                told = ", ".join(f"{n} {verdict}" for verdict, n in e.counts)
                words = f"{title}: {e.title}"
                grid = claims_grid([(e, c) for c in e.rows], words)
                content.append(replace(grid, folded=f"{words} ({told})"))
    return [PagePart("claims", "Every claim", tuple(content))]


def _answers(site: Site) -> CellGrid:
    rows = []
    for answer in site.dossier["answer"]:
        missing, count = answered(site, answer)
        rows.append(
            (
                GridCell(f"{answer['name']}: {answer['title']}", f"thesis.html#{answer['id']}", note=missing),
                GridCell(verdict=MISSING) if missing else GridCell("beside ours"),
                GridCell(count),
            )
        )
    columns = ("of the thesis", "", "numbers beside ours")
    return CellGrid("What the thesis shows, and whether something of ours stands beside it.", columns, tuple(rows), ())


def _left_out(site: Site) -> PagePart:
    rows = []
    for e in site.entries:
        plan = e.run.table("plan") if e.run is not None else None
        if plan is None or not len(plan):
            continue
        for reading, found in plan.groupby("reading", sort=False):
            dropped = found[found["decision"].isin(["dropped", "forced off"])]
            rows.append(
                (
                    GridCell(e.name, f"{e.report}#effects"),
                    GridCell(str(reading)),
                    GridCell(", ".join(map(str, dropped["effect"])) or "nothing"),
                    GridCell(str(len(found))),
                )
            )
    columns = ("experiment", "reading", "left out", "effects looked at")
    content: tuple[Any, ...] = (
        CellGrid(
            "What each planned run left out, because its scene does not call for it.",
            columns,
            tuple(rows),
            ("effects looked at",),
        ),
    )
    if not rows:
        content = (Text(f"{MISSING}: no run with a plan of effects is there."),)
    return PagePart("effects", "Effects left out", content)


def _baseline(site: Site) -> PagePart:
    baseline = site.record["baseline"]
    held = sum(len(c) for c in baseline["holds"].values())
    content: list[Any] = []
    if not baseline["file"]:
        content.append(Text("There is no baseline yet; livlab validate --update-baseline records which claims hold."))
    else:
        content.append(Text(f"{held} claims held when the baseline was recorded ({baseline['file']})."))
    for key, words in _CHANGES:
        rows = tuple(
            (GridCell(c["claim"], note=c["why"]), GridCell(verdict=c["verdict"]), GridCell(c["experiment"]))
            for c in baseline.get(key, ())
        )
        if rows:
            content.append(CellGrid(words, ("claim", "verdict", "experiment"), rows))
    content += [
        Text(f"Not recorded: claims named {pattern['claim']}. {pattern['why']}")
        for pattern in site.dossier["unrecorded"]
    ]
    return PagePart("baseline", "What has changed since the baseline", tuple(content))


_CHANGES = (
    ("lost", "Held then, and no longer."),
    ("undecided", "Held then, and lie too close to their limit now: nothing is lost, and nothing shown."),
    ("gained", "Hold now, and are not in the baseline."),
)


def _facts(site: Site) -> tuple[tuple[str, str], ...]:
    entries = site.entries
    done = sum(e.run is not None for e in entries)
    here = sum(float(row["seconds"]) for row in site.record["experiments"])
    return (
        ("experiments", f"{done} of {len(entries)} have a result"),
        ("took", f"{spelt(sum(e.seconds for e in entries))} in all, {spelt(here)} of it when this site was made"),
        ("made", f"{site.record['made']} by livlab {site.record['livlab']}, on {site.record['cores']} cores"),
        ("again", "livlab validate"),
    )


def _notices(site: Site) -> tuple[str, ...]:
    said = []
    lost = site.record["baseline"]["lost"]
    if lost:
        one = len(lost) == 1
        said.append(
            f"{len(lost)} claim{'' if one else 's'} that held no longer hold{'s' if one else ''}: see the baseline."
        )
    close = len(site.record["baseline"].get("undecided", ()))
    if close:
        said.append(f"{close} that held {'is' if close == 1 else 'are'} too close to a limit now: see the baseline.")
    without = [e.name for e in site.entries if e.run is None]
    if without:
        said.append(f"{MISSING}: no result of {', '.join(without)}.")
    return tuple(said)
