"""What the report of a spectral run shows between its claims and its provenance."""

from __future__ import annotations

import numpy as np

from livlab.reports import figures
from livlab.reports.bench import bench_section
from livlab.reports.effects import simulated
from livlab.reports.folder import RunData
from livlab.reports.readings import readings_section
from livlab.reports.tables import ReportSection, Text, from_frame, with_error
from livlab.reports.tissue import tissue_section


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
