"""What a BRDF experiment's report shows: the spheres, where their samples lie, lobes, fits, and the cuts compared."""

from __future__ import annotations

import base64
from typing import Any

import pandas as pd

from livlab.core.picture_files import png_size
from livlab.kinds.brdf import report_figures as drawn
from livlab.reports.figures import Pictures
from livlab.reports.folder import RunData, beneath
from livlab.reports.tables import Image, Images, ReportSection, Text, from_frame, number, with_error

_FIT = ("pose", "parameter", "value", "95 % interval")
PERCENT = ("relative_rms", "weighted_rms", "percentile_99", "worst", "coverage")


def brdf_sections(run: RunData, pictures: Pictures) -> list[ReportSection]:
    """The sections of a BRDF run between its claims and its provenance."""
    if run.config.get("tissue") is None:
        return [_spheres(run), _samples(run, pictures), _lobes(run, pictures), _fits(run)]
    from livlab.reports.readings import readings_section
    from livlab.reports.tissue import tissue_section

    return [
        _spheres(run),
        _cuts(run, pictures),
        _liver_lobes(run, pictures),
        _samples(run, pictures),
        _fits(run),
        _radius(run, pictures),
        tissue_section(run),
        readings_section(run),
    ]


def _spheres(run: RunData) -> ReportSection:
    section = ReportSection("spheres", "The spheres")
    rig = run.config.get("rig", {})
    lights = rig.get("lights", {})
    count = len(lights.get("list_deg", [])) or lights.get("count", 8)
    distance = lights.get("distance_radii", 10.0)
    where = "far away" if distance == "infinite" else f"at {number(distance)} radii"
    section.content.append(
        Text(
            f"{count} lights ({lights.get('layout', 'arc')}) {where}, one picture each; a {rig.get('projection')} "
            f"camera at {number(rig.get('camera_radii'))} radii; the outline has a radius of "
            f"{number(rig.get('radius_px'))} pixels, the sphere of {number(rig.get('radius_mm'))} mm."
        )
    )
    items = []
    for row in run.table("pictures").to_dict("records"):
        path = beneath(run.path, row.get("png"))
        if path is None:
            continue
        subject = str(row.get("material") or row.get("reading"))
        source = "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
        caption = f"{subject}, exposure × {number(float(row['exposure']), 3)}"
        items.append(Image(source, f"{subject}: the sphere under each light", caption, *png_size(path)))
    if items:
        section.content.append(Images(tuple(items), large=len(items) == 1))
    return section


def _samples(run: RunData, pictures: Pictures) -> ReportSection:
    section = ReportSection("samples", "The samples")
    table = run.table("samples")
    if len(table):
        shown = table.copy()
        for name in PERCENT:
            if name in shown:
                shown[name] = [f"{100 * x:.3g} %" if pd.notna(x) else "–" for x in shown[name]]
        section.content.append(
            from_frame(
                shown,
                "One sample for each light and pixel that sees the sphere within the largest angle. "
                + (
                    "Relative rms: of f / f_true − 1. Weighted: cosine-weighted difference over the weighted truth. "
                    if "relative_rms" in shown
                    else "Median error: of one sample's own standard error over its value. "
                )
                + "Coverage: share of the reachable cells of 2° × 2° × 4° of half-angle coordinates with samples.",
                titles={"percentile_99": "99th percentile"},
            )
        )
    if run.result is not None and "cell_error" in run.result:
        dim = "material" if "material" in run.result.dims else "reading"
        names = [str(x) for x in run.result[dim].values]
        section.content.append(
            pictures.add(
                "half-angles",
                drawn.half_angle_maps(run.result, names, dim),
                "Where the samples lie in half-angle coordinates, over all azimuths, and there their rms relative "
                + ("error" if dim == "material" else "standard error, a sample each")
                + ". Blank: no sample.",
            )
        )
    poses = run.table("poses")
    if len(poses):
        section.content.append(
            from_frame(
                poses,
                "The sphere as its outline frame shows it, against where it was put.",
                only=["material", "centre_off_px", "radius_off_px", "residual_px"],
                titles={"centre_off_px": "centre off [px]", "radius_off_px": "radius off [px]",
                        "residual_px": "residual of the outline [px]"},
                folded="The pose from the outline",
            )
        )  # fmt: skip
    return section


def _lobes(run: RunData, pictures: Pictures) -> ReportSection:
    section = ReportSection("lobes", "Lobes in the plane of incidence")
    if run.result is None or "measured" not in run.result:
        return section
    for k, name in enumerate(str(m) for m in run.result["material"].values):
        section.content.append(
            pictures.add(
                f"lobes-{k + 1}",
                drawn.lobes(run.result.isel(material=k)),
                f"{name}: means of the samples within 0.5° of each incidence and 1.5° of its plane, in bins of 2°; "
                "minus: on the light's side. Lines: the material itself and the fit.",
            )
        )
    return section


def _fits(run: RunData) -> ReportSection:
    section = ReportSection("fits", "The fits")
    table = run.table("fits")
    if not len(table):
        return section
    subject = "material" if "material" in table else "reading"
    for (name, model, loss), part in table.groupby([subject, "model", "loss"], sort=False):
        seconds = ", ".join(f"{number(float(x), 3)} s" for x in part["seconds"].drop_duplicates())
        section.content.append(
            from_frame(
                _spelled(part),
                f"{name}: {model}, loss {loss}; {seconds}.",
                only=[*_FIT, *(["true", "relative error"] if part["true"].notna().any() else []), "status"],
                folded="" if subject == "reading" else f"{name}: {_range(part)}",
            )
        )
        # Runs of before fits were held against the noise have no such column.
        told = [part[c].dropna().unique() for c in ("misfit", "warning") if c in part]
        section.content.extend(Text(f"{name}: {text}") for texts in told for text in texts)
    return section


def _range(part: pd.DataFrame) -> str:
    """The largest relative error under each pose."""
    said = [
        f"{100 * rows['relative_error'].abs().max():.2g} % with the pose {'known' if pose == 'known' else 'found'}"
        for pose, rows in part.groupby("pose", sort=False)
        if rows["relative_error"].notna().any()
    ]
    return "parameters within " + ", ".join(said) if said else "parameters"


def _spelled(table: pd.DataFrame) -> pd.DataFrame:
    """Fit rows with as many digits as the intervals are worth."""
    rows = []
    for row in table.to_dict("records"):
        known = pd.notna(row["low"]) and pd.notna(row["high"])
        rows.append(
            {
                **row,
                "value": f"{row['value']:.6g}",
                "95 % interval": f"{row['low']:.6g} to {row['high']:.6g}" if known else "–",
                "relative error": f"{100 * row['relative_error']:+.4f} %" if pd.notna(row["relative_error"]) else "–",
                "true": f"{row['true']:g}" if pd.notna(row["true"]) else None,
            }
        )
    return pd.DataFrame(rows).dropna(axis="columns", how="all")


def _cuts(run: RunData, pictures: Pictures) -> ReportSection:
    scan = dict(run.config.get("scan", {}))
    collinear = scan.get("kind") == "collinear"
    title = "Light and camera together" if collinear else f"Light at {number(scan.get('incidence_deg'))}°"
    section = ReportSection("cuts", title)
    if run.result is None or "cut_sphere" not in run.result:
        return section
    section.content.append(
        pictures.add(
            "cuts",
            drawn.cuts(run.result, str(scan.get("kind"))),
            "The BRDF read from the sphere's pictures, and of a flat sample of the same tissue in a virtual "
            "goniometer, each with ±2 standard errors; the Nunes 2017 form (Lambert and an isotropic "
            "Ashikhmin–Shirley lobe) fitted to the sphere's samples. What the smooth surface mirrors is in none of "
            "them; what an interface below mirrors is, and shows where the layer above hardly scatters.",
        )
    )
    table = run.table("comparison")
    if len(table):
        section.content.append(
            from_frame(
                _compared(table),
                "The curves compared over the angles where the sphere has samples, ± one standard error. Noise: the "
                "RMSE that the standard errors alone would make. MSE is the thesis's EQM, in 1/sr².",
                titles={"wavelength_nm": "wavelength [nm]", "noise_rmse": "noise", "ratio": "mean ratio"},
            )
        )
    values = run.table("cuts")
    if len(values):
        section.content.append(from_frame(values, "Every point of the curves.", folded="The numbers"))
    return section


def _compared(table: pd.DataFrame) -> pd.DataFrame:
    """The comparison with as many digits as there is room for; the errors of RMSE and MSE are in the folder's table."""
    shown = table.drop(columns=["mse_se", "rmse_se"]).copy()
    shown["wavelength_nm"] = ["all" if pd.isna(x) else f"{x:g}" for x in table["wavelength_nm"]]
    for name in ("rmse", "noise_rmse", "mse"):
        shown[name] = [number(float(f"{x:.2g}")) for x in table[name]]
    return _errors(shown)


def _errors(table: pd.DataFrame) -> pd.DataFrame:
    shown = table.copy()
    for name in [c for c in table.columns if f"{c}_se" in table.columns]:
        shown[name] = [with_error(a, b) for a, b in zip(table[name], table[f"{name}_se"], strict=True)]
        shown = shown.drop(columns=f"{name}_se")
    return shown


def _liver_lobes(run: RunData, pictures: Pictures) -> ReportSection:
    section = ReportSection("lobes", "Lobes in the plane of incidence")
    result: Any = run.result
    if result is None or "flat_lobes" not in result:
        return section
    for w, nm in enumerate(result["wavelength"].to_numpy()):
        section.content.append(
            pictures.add(
                f"lobes-{w + 1}",
                drawn.liver_lobes(result, w),
                f"{nm:g} nm: the flat sample (lines) and the sphere (marks) in the plane of incidence.",
            )
        )
    return section


def _radius(run: RunData, pictures: Pictures) -> ReportSection:
    section = ReportSection("radius", "How large a sphere stands for a flat sample")
    table = run.table("radii")
    if len(table):
        section.content.append(
            pictures.add(
                "radii",
                drawn.radii(table),
                "Mean of f cos θ_i over all samples of a sphere, over that of the largest in the same rig, ±2 standard "
                "errors: light that would come out of a flat sample far from where it went in leaves a small sphere "
                "elsewhere.",
            )
        )
        section.content.append(from_frame(_errors(table), "The ratio at each radius.", folded="The numbers"))
    return section
