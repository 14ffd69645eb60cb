"""What a picture experiment's report shows: the pictures, their colours and errors, and where a reading fails."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import pandas as pd

from livlab.core.picture_files import png_size
from livlab.kinds.picture import report_figures as drawn
from livlab.kinds.picture.report_words import above, alt_text, caption, findings, last_layer, light_words, own_name
from livlab.reports.figures import Pictures
from livlab.reports.folder import RunData, beneath
from livlab.reports.tables import Image, Images, ReportSection, Text, from_frame, number, with_error


def picture_sections(run: RunData, pictures: Pictures) -> list[ReportSection]:
    """The sections of a picture run between its claims and its provenance."""
    from livlab.reports.effects import simulated
    from livlab.reports.readings import readings_section
    from livlab.reports.tissue import tissue_section

    return [
        _pictures(run),
        _baselines(run),
        _colours(run, pictures),
        _absorption(run, pictures),
        _error(run, pictures),
        _ways(run, pictures),
        tissue_section(run),
        readings_section(run),
        simulated(run.table("plan")),
    ]


def shown_pictures(run: RunData, *, baselines: bool = False) -> list[dict[str, Any]]:
    """Rows of pictures.csv whose files are there: the tissues' pictures, or the baselines'."""
    table = run.table("pictures")
    if not len(table):
        return []
    rows = [{str(k): v for k, v in row.items()} for row in table.to_dict("records")]
    return [r for r in rows if pd.notna(r.get("baseline")) == baselines and beneath(run.path, r.get("png")) is not None]


def _inline(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


def _image(run: RunData, row: dict[str, Any]) -> Image:
    path = run.path / str(row["png"])
    return Image(_inline(path), alt_text(run, row), caption(run, row), *png_size(path))


def _pictures(run: RunData) -> ReportSection:
    section = ReportSection("pictures", "The pictures")
    rows = shown_pictures(run)
    if not rows:
        section.content.append(Text("No picture is finished yet; preview.png in the folder shows how far it is."))
        return section
    section.content.append(Text(light_words(run)))
    first = str(rows[0]["route"])
    own = [r for r in rows if r["route"] == first]
    section.content.append(Images(tuple(_image(run, r) for r in own), large=len(own) == 1))
    for text in findings(run):
        section.content.append(Text(text))
    others = [r for r in rows if r["route"] != first]
    if others:
        section.content.append(
            Images(
                tuple(_image(run, r) for r in others),
                "The same light by the other colour routes: the paths are the same, only the way from spectrum to "
                "colour differs.",
            )
        )
    return section


def _baselines(run: RunData) -> ReportSection:
    section = ReportSection("baselines", "Older models in the same light")
    rows = shown_pictures(run, baselines=True)
    if rows:
        first = str(rows[0]["route"])
        section.content.append(
            Images(
                tuple(_image(run, r) for r in rows if r["route"] == first),
                "Each takes the place of the tissue under the same lights and exposure, its numbers from the first "
                "reading: what it knows of the tissue is its diffuse reflectance or its coefficients.",
            )
        )
    return section


def _colours(run: RunData, pictures: Pictures) -> ReportSection:
    section = ReportSection("colours", "Colour of the lit body")
    table = run.table("colours")
    if not len(table):
        return section
    section.content.append(
        pictures.add(
            "colours",
            drawn.colours(table, own_name(run)),
            "Mean colour of the lit body: patches as a screen shows them, and where they lie in CIELAB. Bars: ±2 "
            "standard errors, where they are wider than the marks.",
        )
    )
    several = table["tissue"].notna().any()
    frame = pd.DataFrame(
        {
            **({"tissue": drawn.tissues(table, own_name(run))} if several else {}),
            "reading": table["reading"],
            "route": table["route"],
            "sRGB": table["sRGB"],
            **{f"{w}*": _pm(table, w) for w in ("L", "a", "b")},
            "chroma": [number(float(c), 3) for c in table["chroma"]],
            "hue [°]": _pm(table, "hue"),
        }
    )
    section.content.append(from_frame(frame, "CIELAB under sRGB's white, exposure included, ± one standard error."))
    differences = run.table("differences")
    if len(differences):
        section.content.append(
            from_frame(
                differences.assign(tissue=drawn.tissues(differences, own_name(run)))
                if several
                else differences.drop(columns="tissue"),
                "CIEDE2000 between the colour routes: of the mean colour, and over the lit body's pixels (noise "
                "included). About 1 is just noticeable.",
                titles={
                    "mean_colour": "mean colour",
                    "median_pixel": "median pixel",
                    "p95_pixel": "95 % of pixels below",
                },
            )
        )
    shown = run.table("pictures")
    if len(shown) and {"below_gamut", "above_white", "pixels"} <= set(shown.columns):
        worst = shown.iloc[int((shown["below_gamut"] + shown["above_white"]).to_numpy().argmax())]
        if int(worst["below_gamut"]) + int(worst["above_white"]) > 0:
            section.content.append(
                Text(
                    f"Colours that a screen cannot show were desaturated or clipped; most in {worst['png']}: "
                    f"{number(int(worst['below_gamut']))} of {number(int(worst['pixels']))} pixels are more saturated "
                    f"than sRGB, {number(int(worst['above_white']))} brighter than white. The EXR files hold all."
                )
            )
    return section


def _absorption(run: RunData, pictures: Pictures) -> ReportSection:
    section = ReportSection("absorption", "What the tissue absorbs")
    table = run.table("absorption")
    if len(table):
        section.content.append(
            pictures.add(
                "absorption",
                drawn.absorption(table, own_name(run)),
                f"Absorption coefficient of {last_layer(run)}, all of its elements together, as Nunes 2019 draws it "
                "in Fig. 7.9. Vertical lines: the thesis's red, green and blue.",
            )
        )
    optics = run.table("optics")
    if len(optics):
        several = optics["tissue"].notna().any()
        kept = optics["kept_by_redirection"].fillna(1.0).lt(1.0).any()
        if not kept:
            optics = optics.drop(columns="kept_by_redirection")
        section.content.append(
            from_frame(
                optics.assign(tissue=drawn.tissues(optics, own_name(run)))
                if several
                else optics.drop(columns="tissue"),
                f"What colour comes from: {last_layer(run)} at the channels' middles. The reduced albedo is "
                "µs'/(µa + µs')"
                + ("; a redirection keeps only the share shown of the light" if kept else "")
                + (f"; above it lies {above(run)}." if above(run) != "what lies" else "."),
                titles={
                    "wavelength_nm": "wavelength [nm]",
                    "absorption_per_mm": "µa [1/mm]",
                    "reduced_scattering_per_mm": "µs' [1/mm]",
                    "reduced_albedo": "reduced albedo",
                    "kept_by_redirection": "kept by a redirection",
                    "depth_above": "µs' × thickness above",
                },
            )
        )
    return section


def _error(run: RunData, pictures: Pictures) -> ReportSection:
    section = ReportSection("error", "How good the pictures are")
    table = run.table("convergence")
    if len(table):
        section.content.append(
            pictures.add(
                "convergence",
                drawn.convergence(table, own_name(run)),
                "A pixel's relative standard error (mean over the wavelengths, median over the lit body) while the "
                "picture was taken; dashed: slope −1/2, as a Monte Carlo error falls.",
            )
        )
    costs = run.table("costs")
    made = costs.loc[costs["stage"] == "picture"] if len(costs) else costs
    if len(made):
        several = made["tissue"].notna().any()
        shown = made.assign(
            tissue=drawn.tissues(made, own_name(run)),
            relative_error=[f"{100 * e:.2f} %" for e in made["relative_error"]],
        )
        names = [
            "reading",
            "spp",
            "wavelengths",
            "seconds",
            "compile_seconds",
            "samples_per_second",
            "relative_error",
            "memory_gib",
        ]
        section.content.append(
            from_frame(
                shown,
                "What each picture cost. Memory is the process's peak until then.",
                only=[*(["tissue"] if several else []), *names],
                titles={
                    "memory_gib": "memory [GiB]",
                    "samples_per_second": "samples/s",
                    "compile_seconds": "of them compiling",
                },
            )
        )
    return section


def _ways(run: RunData, pictures: Pictures) -> ReportSection:
    section = ReportSection("ways", "What each way of following light costs")
    table = run.table("ways")
    if len(table):
        section.content.append(
            pictures.add(
                "ways",
                drawn.ways(table),
                "Image error against time on a small copy of the picture, all wavelengths, compiling apart: two "
                "pictures with other seeds, their difference over √2, over the mean radiance. Left: root mean square "
                "over the lit body and the wavelengths, which a few very bright pixels can rule; right: 1.48 of the "
                "median, the same where errors are normal, and too small where rare bright paths carry light.",
            )
        )
        section.content.append(from_frame(table, "Every picture tried.", folded="The numbers"))
    return section


def _pm(table: pd.DataFrame, what: str) -> list[str]:
    return [with_error(float(v), float(e)) for v, e in zip(table[what], table[f"{what}_se"], strict=True)]
