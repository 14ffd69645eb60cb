"""The thesis beside ours: what it shows in words, its numbers and ours, and why they differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from livlab.dossier.parts import copied_pictures, shown_figures
from livlab.dossier.site import MISSING, CellGrid, GridCell, Site, looked_up
from livlab.reports.tables import Text, number, with_error


def answered(site: Site, answer: Mapping[str, Any]) -> tuple[str, str]:
    """Why a figure or table of the thesis is MISSING ("" if it is not), and how many of its numbers have ours."""
    found = [n for n in answer["number"] if n["ours"] and looked_up(site, n["ours"])[0] is not None]
    count = f"{len(found)} of {len(answer['number'])}" if answer["number"] else "–"
    reasons = []
    if answer["missing"]:
        reasons.append(str(answer["missing"]).strip())
    needed = [str(s["experiment"]) for s in answer["show"]]
    needed += [str(n["ours"]["experiment"]) for n in answer["number"] if n["ours"]]
    for name in dict.fromkeys(needed):
        entry = site.entry(name)
        if entry.run is None:
            reasons.append(f"{name}: {entry.reason}")
    return "; ".join(reasons), count


def thesis_parts(site: Site, answer: Mapping[str, Any]) -> tuple[str, list[Any], list[Any], list[Any]]:
    """Why it is missing, then what stands on the left, on the right, and beneath."""
    missing, _ = answered(site, answer)
    left: list[Any] = [Text(str(answer["shows"]).strip())]
    right: list[Any] = []
    for shown in answer["show"]:
        entry = site.entry(str(shown["experiment"]))
        if entry.run is None:
            right.append(Text(f"{MISSING}: {entry.name}: {entry.reason}"))
            continue
        if shown["pictures"]:
            right += [c for c in copied_pictures(entry, site.out) if not getattr(c, "caption", "")]
        right += shown_figures(entry, shown["figures"], str(answer["id"]))
        right.append(CellGrid("", ("from",), ((GridCell(f"Report: {entry.title}", entry.report),),), kind="link"))
    after: list[Any] = []
    if answer["number"]:
        after.append(_numbers(site, answer))
    if answer["deviation"]:
        after.append(Text(str(answer["deviation"]).strip()))
    return missing, left, right, after


def _numbers(site: Site, answer: Mapping[str, Any]) -> CellGrid:
    rows = []
    for n in answer["number"]:
        found, reason = looked_up(site, n["ours"]) if n["ours"] else (None, str(n["missing"]).strip())
        why = str(n["why"]).strip()
        if found is None:
            rows.append(
                (
                    GridCell(n["what"], note=why),
                    GridCell(n["printed"]),
                    GridCell(note=reason),
                    GridCell(verdict=MISSING),
                    GridCell(),
                )
            )
            continue
        value, error = found["value"], found["error"]
        if isinstance(value, str):
            text = value
        else:
            text = with_error(float(value), float(error)) if error is not None else number(float(value))
        rows.append(
            (
                GridCell(n["what"], note=why),
                GridCell(n["printed"]),
                GridCell(f"{text} {n['unit']}".strip()),
                GridCell(verdict=found["verdict"]) if found["verdict"] else GridCell("–"),
                GridCell(str(n["ours"]["experiment"]), site.entry(str(n["ours"]["experiment"])).report),
            )
        )
    columns = ("what", "the thesis prints", "ours", "claim", "from")
    return CellGrid(f"Numbers of {answer['name']}, and ours.", columns, tuple(rows))
