"""What the report of an optics run shows between its claims and its provenance."""

from __future__ import annotations

import pandas as pd
import xarray as xr

from livlab.kinds.optics import report_figures as draw
from livlab.reports.figures import Pictures
from livlab.reports.folder import RunData
from livlab.reports.tables import ReportSection, Text, from_frame, number


def sections(run: RunData, pictures: Pictures) -> list[ReportSection]:
    """Sections of a run of kind "optics"."""
    if run.result is None:
        return []
    return _scattering(run, run.result, pictures) if "mie" in run.result else _absorption(run, run.result, pictures)


def _scattering(run: RunData, data: xr.Dataset, pictures: Pictures) -> list[ReportSection]:
    at = number(float(data.attrs["phase_wavelength_nm"]))
    directions = ReportSection("phase", "Where a sphere sends the light")
    directions.content.extend(
        [
            pictures.add(
                "phase-polar",
                draw.polar(data),
                f"Phase functions at {at} nm around the sphere, light coming from the left and going to 0°; each over "
                "its own largest value.",
            ),
            pictures.add(
                "phase",
                draw.phase(data),
                f"The same phase functions at {at} nm against the scattering angle; each integrates to 1.",
            ),
        ]
    )
    curves = ReportSection("spectra", "How much it scatters, over the wavelengths")
    curves.content.extend(
        [
            pictures.add(
                "spectra",
                draw.spectra(data),
                "Scattering efficiency over its own maximum: the shape alone, as the thesis compares it.",
            ),
            pictures.add(
                "efficiencies",
                draw.efficiencies(data),
                "The same efficiencies as they are: cross section over π r². Rayleigh's has no bound, Mie's stays of "
                "order 1.",
            ),
            from_frame(_summary(run.table("efficiencies")), "Over the wavelengths drawn, from the first to the last."),
        ]
    )
    limits = ReportSection("validity", "Where Rayleigh's law holds")
    limits.content.extend(
        [
            Text(_verdict(run.table("validity"))),
            pictures.add(
                "validity",
                draw.validity(data),
                "Rayleigh's efficiency over Mie's. Bars: the size parameters of the spheres above over the band.",
            ),
        ]
    )
    return [directions, curves, limits]


def _summary(table: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for (particle, radius), part in table.groupby(["particle", "radius_um"], sort=False):
        ratio = part["q_sca_rayleigh"] / part["q_sca_mie"]
        rows.append(
            {
                "particle": particle,
                "radius [µm]": radius,
                "size parameter": _span(part["size_parameter"]),
                "Mie": _span(part["q_sca_mie"]),
                "Rayleigh": _span(part["q_sca_rayleigh"]),
                "Rayleigh / Mie": _span(ratio),
                "anisotropy (Mie)": _span(part["anisotropy_mie"]),
            }
        )
    return pd.DataFrame(rows)


def _verdict(table: pd.DataFrame) -> str:
    told = []
    for particle, part in table.groupby("particle", sort=False):
        off = (part["rayleigh_over_mie"] - 1.0).abs() > 0.1
        first = part["size_parameter"][off].min() if off.any() else part["size_parameter"].max()
        told.append(f"{particle} to a size parameter of {number(float(first), 2)}")
    return (
        f"Rayleigh's efficiency is within 10 % of Mie's {', '.join(told)}. The thesis asks for a radius under a tenth "
        "of the wavelength, a size parameter under 0.63 where that is the wavelength in the medium."
    )


def _span(values: pd.Series) -> str:
    return f"{number(float(values.iloc[0]), 3)} to {number(float(values.iloc[-1]), 3)}"


def _absorption(run: RunData, data: xr.Dataset, pictures: Pictures) -> list[ReportSection]:
    section = ReportSection("absorption", "What absorbs, and where")
    section.content.append(
        pictures.add(
            "absorption",
            draw.absorption(data),
            "Absorption coefficient of each substance undiluted; a curve ends where its dataset does.",
        )
    )
    table = run.table("absorption")
    if len(table):
        wide = table.pivot_table(index="wavelength_nm", columns="chromophore", values="absorption_per_cm", sort=False)
        wide = wide.loc[[x for x in wide.index if x % 20 == 0]].reset_index()
        wide = wide.rename(columns={"wavelength_nm": "wavelength [nm]"})
        section.content.append(
            from_frame(wide, "Absorption in 1/cm every 20 nm; absorption.csv has all of it.", folded="The numbers")
        )
    return [section]
