"""Build the report page of a run folder."""

from __future__ import annotations

import importlib
import json
from collections import Counter
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from livlab.reports import cost, figures, reviewer
from livlab.reports.bench import bench_section
from livlab.reports.effects import simulated
from livlab.reports.folder import RunData, read_run, sound
from livlab.reports.readings import readings_section
from livlab.reports.stress import hard_cases
from livlab.reports.tables import (
    ClaimTable,
    ReportSection,
    Text,
    claim_rows,
    from_frame,
    merge_readings,
    number,
    with_error,
)
from livlab.runs.files import told_plainly, write_whole

ICONS = {"PASS": "✓", "FAIL": "✗", "MISSING": "?"}

BODIES = {
    "fit": "livlab.kinds.fit.report:fit_sections",
    "ladder": "livlab.reports.page:tissue_sections",
    "optics": "livlab.kinds.optics.report:sections",
    "brdf": "livlab.kinds.brdf.report:brdf_sections",
    "spectral": "livlab.reports.page:spectral_sections",
    "picture": "livlab.kinds.picture.report:picture_sections",
    "stress": "livlab.reports.page:tissue_sections",
    "study": "livlab.kinds.study.report:study_sections",
}
"""What a kind of experiment shows between its claims and its provenance: `sections(run, pictures) -> [sections]`,
as "module:function", imported on use."""


def build_report(run_folder: Path) -> Path:
    """Write `report.html` and `figures/*.svg` from what a run folder holds, and nothing else.

    The page is one file: no request to anywhere, no script but a bench's own, everything escaped that came from a
    user's file.

    Raises
    ------
    InputError
        The folder is not a run folder, or is damaged.
    EnvironmentProblem
        The page cannot be written.
    """
    run = read_run(run_folder)
    with sound(run):
        return _built(run)


def _built(run: RunData) -> Path:
    pictures = figures.Pictures()
    sections = [s for s in _sections(run, pictures) if s.content]
    environment = Environment(
        loader=PackageLoader("livlab.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    counts = Counter(row["verdict"] for row in claim_rows(run.claims, {}))
    text = environment.get_template("report.html.j2").render(
        title=str(run.config.get("title") or run.manifest.get("name", run.path.name)),
        description=str(run.config.get("description", "")),
        manifest={"livlab": run.manifest.get("livlab", "unknown"), **run.manifest},
        css=Markup(files("livlab.reports").joinpath("templates/style.css").read_text(encoding="utf-8")),
        verdicts=[(v, counts[v]) for v in ICONS if counts[v]],
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


def _sections(run: RunData, pictures: figures.Pictures) -> list[ReportSection]:
    claims = ReportSection("claims", "What is claimed, and whether it holds")
    if len(run.claims):
        claims.content.append(
            ClaimTable(
                "A claim passes when its value lies within the tolerance of the reference. "
                "MISSING: the reference or the value is not available.",
                claim_rows(run.claims, dict(run.manifest.get("claim_notes", {}))),
            )
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
        *_body(run)(run, pictures),
        reviewer.provenance(run),
        _cost(run, pictures),
        hard_cases(run.table("stress")),
        reviewer.again(run),
    ]


def _body(run: RunData) -> Callable[[RunData, figures.Pictures], list[ReportSection]]:
    """Builder of the sections that only this kind of run has."""
    module, _, name = BODIES.get(str(run.manifest.get("kind") or "spectral"), BODIES["spectral"]).partition(":")
    found: Callable[[RunData, figures.Pictures], list[ReportSection]] = getattr(importlib.import_module(module), name)
    return found


def spectral_sections(run: RunData, pictures: figures.Pictures) -> list[ReportSection]:
    """What a spectral experiment shows."""
    return [
        _curves(run, pictures),
        *bench_section(run),
        _coefficients(run, pictures),
        _budget(run, pictures),
        tissue_section(run),
        readings_section(run),
        simulated(run.table("plan")),
    ]


def tissue_sections(run: RunData, _: figures.Pictures) -> list[ReportSection]:
    """What an experiment shows that checks livlab itself; its tables have sections of their own."""
    return [tissue_section(run)]


def _curves(run: RunData, pictures: figures.Pictures) -> ReportSection:
    section = ReportSection("curves", "The measured curves")
    if run.result is None:
        section.content.append(Text("No reading has been measured yet."))
        return section
    if "curve" in run.result:
        smoothing = str(run.result.attrs.get("smoothing", "")).strip()
        section.content.append(
            pictures.add(
                "curves",
                figures.curves(run.result),
                "Each reading's curve as the virtual instrument saw it"
                + (
                    ", against the reference. Bands: ±2 standard errors of the simulation; grey: ±1 SD of the "
                    "reference over its subjects. Beneath: what is left."
                    if "reference_name" in run.result
                    else "; this run has no reference. Bands: ±2 standard errors of the simulation."
                )
                + (f" Processing: {smoothing}." if smoothing else ""),
            )
        )
    section.content.append(
        pictures.add(
            "absolute",
            figures.absolute(run.result),
            "The same readings before any normalisation, at the simulated wavelengths; bars: ±2 standard errors.",
        )
    )
    spectra = run.table("spectra")
    if len(spectra):
        if {"reflectance", "standard_error"} <= set(spectra.columns):
            pairs = zip(spectra["reflectance"], spectra["standard_error"], strict=True)
            spectra = spectra.assign(reflectance=[with_error(v, e) for v, e in pairs]).drop(columns="standard_error")
        section.content.append(
            from_frame(
                spectra,
                "The simulated values at every wavelength.",
                titles={"wavelength_nm": "wavelength [nm]"},
                folded="The numbers",
            )
        )
    return section


def _coefficients(run: RunData, pictures: figures.Pictures) -> ReportSection:
    section = ReportSection("coefficients", "What the tissue is made of, optically")
    if run.coefficients is not None:
        section.content.append(
            pictures.add(
                "coefficients",
                figures.coefficients(run.coefficients),
                "Absorption and scattering coefficient of every element in the tissue (the largest over its layers), "
                "under each reading. A curve that is missing is zero.",
            )
        )
    return section


def _budget(run: RunData, pictures: figures.Pictures) -> ReportSection:
    section = ReportSection("energy", "Where the light went")
    if run.result is None:
        return section
    parts = figures.budget_parts(run.result)
    if not parts:
        return section
    section.content.append(
        pictures.add(
            "energy",
            figures.budget(run.result),
            "Shares of the incident light at every wavelength; they add up to 1 within the residual.",
        )
    )
    readings = [str(r) for r in run.result["reading"].values]
    if "redirect_loss" in run.result:
        loss = run.result["redirect_loss"].transpose("reading", "wavelength").to_numpy()
        for k, reading in enumerate(readings):
            largest = float(np.nanmax(np.abs(loss[k]), initial=0.0))
            if largest > 1e-9:
                section.content.append(
                    Text(
                        f"The {reading} reading does not conserve energy: the cosine factor of the thesis's "
                        f"Algorithm 2 removes up to {100 * largest:.1f} % of the incident light; no element absorbs it."
                    )
                )
    worst = float(np.nanmax(np.abs(1.0 - sum(values for label, values in parts if label != "residual"))))
    section.content.append(Text(f"Largest share unaccounted for, over all readings and wavelengths: {worst:.0e}."))
    table = run.table("budget")
    if len(table):
        section.content.append(from_frame(table, "The budget at every wavelength.", folded="The numbers"))
    return section


def tissue_section(run: RunData) -> ReportSection:
    """The tissue's parameters as each reading takes them."""
    section = ReportSection("tissue", "The tissue")
    table = run.table("tissue")
    if len(table):
        section.content.append(
            from_frame(
                merge_readings(table),
                "Layers from the lit side down, their elements and parameters, and where each is from.",
                only=["layer", "element", "parameter", "value", "unit", "reading", "source"],
            )
        )
    return section


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
