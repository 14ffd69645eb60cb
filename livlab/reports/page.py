"""Build the report page of a run folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from livlab.criteria.judging import verdict_counts
from livlab.reports import cost, figures, reviewer
from livlab.reports.folder import RunData, read_run, sound
from livlab.reports.stress import hard_cases
from livlab.reports.tables import (
    ReportSection,
    Text,
    claim_rows,
    claim_tables,
    from_frame,
    number,
)
from livlab.runs.files import told_plainly, write_whole

ICONS = {"PASS": "✓", "FAIL": "✗", "TOO CLOSE": "≈", "MISSING": "?"}


RULE = (
    "PASS and FAIL: the value lies within its limits, or beyond one, by more than two standard errors; an exact one, "
    "by anything. TOO CLOSE: nearer than that, with the samples that would settle it. MISSING: there is no value or no "
    "reference."
)
FORMER_RULE = (
    "Judged by an older livlab, and shown as judged then: PASS within the tolerance of the reference, FAIL beyond it "
    "or where the standard error exceeds half the tolerance. Run it again for verdicts by today's rule (TOO CLOSE "
    "within two standard errors of a limit, one limit for agreement)."
)

Body = Callable[[RunData, figures.Pictures], list[ReportSection]]
"""What a kind of experiment shows between its claims and its provenance."""


def build_report(run_folder: Path, body: Body) -> Path:
    """Write `report.html` and `figures/*.svg` from what a run folder holds, and nothing else.

    The page is one file: no request to anywhere, no script but a bench's own, everything escaped that came from a
    user's file.

    Parameters
    ----------
    run_folder
        The run.
    body
        Gives the sections that only this kind of run has; it draws into the pictures that it is handed.

    Raises
    ------
    InputError
        The folder is not a run folder, or is damaged.
    EnvironmentProblem
        The page cannot be written.
    """
    run = read_run(run_folder)
    with sound(run):
        return _built(run, body)


def _built(run: RunData, body: Body) -> Path:
    pictures = figures.Pictures()
    sections = [s for s in _sections(run, pictures, body) if s.content]
    environment = Environment(
        loader=PackageLoader("livlab.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    rows = claim_rows(run.claims, {})
    text = environment.get_template("report.html.j2").render(
        title=str(run.config.get("title") or run.manifest.get("name", run.path.name)),
        description=str(run.config.get("description", "")),
        manifest={"livlab": run.manifest.get("livlab", "unknown"), **run.manifest},
        css=Markup(files("livlab.reports").joinpath("templates/style.css").read_text(encoding="utf-8")),
        verdicts=verdict_counts(rows),
        groups=[(t.title, t.counts) for t in claim_tables(rows, run.tissue)],
        icons=ICONS,
        facts=_facts(run),
        complete=run.complete,
        rerun=str(run.manifest.get("command", "livlab run")),
        notes=[str(n) for n in run.manifest.get("notes", [])],
        sections=sections,
        folder=run.path.name,
    )
    with told_plainly(run.path):
        (run.path / "figures").mkdir(exist_ok=True)
    for name, svg in pictures.plain.items():
        write_whole(run.path / "figures" / f"{name}.svg", '<?xml version="1.0" encoding="utf-8"?>\n' + svg)
    write_whole(run.path / "report.html", text)
    return run.path / "report.html"


def _facts(run: RunData) -> list[tuple[str, str]]:
    m = run.manifest
    rows = [
        ("run", f"{m.get('name', run.path.name)} · {str(m.get('digest', ''))[:12]}"),
        ("finished", str(m.get("finished") or "not yet")),
        ("took", f"{number(m.get('seconds'), 3)} s"),
    ]
    if run.result is not None and "wavelength" in run.result:
        wavelength = run.result["wavelength"].to_numpy()
        span = f"{number(float(wavelength[0]))}–{number(float(wavelength[-1]))} nm, {len(wavelength)} wavelengths"
        rows.append(("band", span if len(wavelength) > 1 else f"{number(float(wavelength[0]))} nm"))
        instrument = run.result.attrs.get("instrument")
        if instrument:
            rows.append(("instrument", _spell(instrument)))
    return rows


def _spell(instrument: Any) -> str:
    try:
        data = json.loads(instrument) if isinstance(instrument, str) else dict(instrument)
    except ValueError:
        return str(instrument)
    kind = data.pop("kind", "instrument")
    parts = [f"{k.replace('_', ' ')} {number(v)}" for k, v in data.items()]
    return f"{kind} ({', '.join(parts)})" if parts else str(kind)


def _sections(run: RunData, pictures: figures.Pictures, body: Body) -> list[ReportSection]:
    claims = ReportSection("claims", "What is claimed, and whether it holds")
    if len(run.claims):
        claims.content.append(Text(FORMER_RULE if run.former_rule else RULE))
        claims.content.extend(
            claim_tables(claim_rows(run.claims, dict(run.manifest.get("claim_notes", {}))), run.tissue)
        )
        if len(run.table("metrics")):
            claims.content.append(
                from_frame(
                    run.table("metrics"),
                    "Each metric with its bootstrap interval over the simulation's errors and the reference's.",
                    folded="95 % intervals",
                )
            )
    else:
        claims.content.append(Text("This run makes no claims."))
    return [
        claims,
        *body(run, pictures),
        reviewer.provenance(run),
        _cost(run, pictures),
        hard_cases(run.table("stress")),
        reviewer.again(run),
    ]


def _cost(run: RunData, pictures: figures.Pictures) -> ReportSection:
    section = ReportSection("cost", "What it cost")
    costs = run.table("costs")
    if not len(costs):
        return section
    stages = costs[[c for c in costs.columns if c not in ("solver", "error", "relative_error")]]
    if "error" in costs and costs["error"].notna().any():
        section.content.append(from_frame(cost.run_rows(costs), "What each reading's accuracy cost."))
        convergence = run.table("convergence")
        if len(convergence):
            section.content.append(
                pictures.add(
                    "cost",
                    cost.run_figure(costs, convergence),
                    "How the error fell while each reading was sampled; dashed, with slope −1/2, on to its next digit.",
                )
            )
    simulated = costs[costs["samples"].fillna(0) > 0] if "samples" in costs else pd.DataFrame()
    if len(simulated):
        seconds = float(simulated["seconds"].sum())
        section.content.append(
            Text(
                f"Sampling took {number(seconds, 3)} s. A Monte Carlo error falls with the square root of the samples: "
                f"the next digit costs 100×, {cost.duration(100 * seconds)} here."
            )
        )
    section.content.append(from_frame(stages, "Wall-clock time of each stage on the machine named below."))
    _every_solver(run, pictures, section)
    return section


def _every_solver(run: RunData, pictures: figures.Pictures, section: ReportSection) -> None:
    """What `livlab cost` found on this run's scene, if it was asked."""
    table = run.table("cost")
    if not len(table):
        return
    reading = str(table["reading"].iloc[0])
    section.content.append(
        pictures.add(
            "cost-of-every-solver",
            cost.cost_figure(table),
            f"Every solver on the scene of the {reading} reading: error against time. Hollow: as the solver states it, "
            "since the reference is no better. Dotted: off by a bias that no time mends.",
        )
    )
    section.content.append(Text(cost.sentence(table)))
    shown = ["solver", "samples", "seconds", "error", "stated", "valid", "notes"]
    section.content.append(from_frame(table, "Every solver tried.", only=shown, folded="The numbers"))
