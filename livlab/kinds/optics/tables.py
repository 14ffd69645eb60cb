"""The CSV tables of an optics run: columns, and rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from livlab.kinds.optics.config import OpticsExperiment
from livlab.kinds.shared.tissue_tables import Made, Rows, sources


def efficiencies(data: xr.Dataset) -> Made:
    """Scattering efficiencies by both theories, and Mie's anisotropy."""
    limit = float(data.attrs["rayleigh_size_limit"])
    out: Rows = []
    for (particle, radius), at in _each(data):
        names = ("wavelength", "size_parameter", "mie", "rayleigh", "anisotropy")
        for x, size, series, law, g in zip(*(at[n].to_numpy().tolist() for n in names), strict=True):
            out.append(
                {
                    "particle": particle,
                    "radius_um": radius,
                    "wavelength_nm": x,
                    "size_parameter": size,
                    "q_sca_mie": series,
                    "q_sca_rayleigh": law,
                    "anisotropy_mie": g,
                    "within_rayleigh": size < limit,
                }
            )
    columns = ("wavelength_nm", "size_parameter", "q_sca_mie", "q_sca_rayleigh", "anisotropy_mie", "within_rayleigh")
    return ("particle", "radius_um", *columns), out


def phase(data: xr.Dataset) -> Made:
    """Phase functions by both theories, in 1/sr."""
    out: Rows = []
    degrees = np.degrees(data["theta"].to_numpy())
    for (particle, radius), at in _each(data):
        pairs = (at["phase_mie"].to_numpy().tolist(), at["phase_rayleigh"].to_numpy().tolist())
        out += [
            {"particle": particle, "radius_um": radius, "angle_deg": t, "mie_per_sr": a, "rayleigh_per_sr": b}
            for t, a, b in zip(degrees.tolist(), *pairs, strict=True)
        ]
    return ("particle", "radius_um", "angle_deg", "mie_per_sr", "rayleigh_per_sr"), out


def validity(data: xr.Dataset) -> Made:
    """Rayleigh's efficiency over Mie's against the size parameter."""
    out: Rows = [
        {"particle": str(name), "size_parameter": x, "rayleigh_over_mie": y}
        for name in data["particle"].to_numpy()
        for x, y in zip(
            data["size"].to_numpy().tolist(), data["ratio"].sel(particle=name).to_numpy().tolist(), strict=True
        )
    ]
    return ("particle", "size_parameter", "rayleigh_over_mie"), out


def absorption(data: xr.Dataset) -> Made:
    """Absorption of every chromophore where its dataset has it."""
    out: Rows = [
        {"chromophore": str(name), "wavelength_nm": x, "absorption_per_cm": y}
        for name in data["chromophore"].to_numpy()
        for x, y in zip(
            data["wavelength"].to_numpy().tolist(),
            data["absorption"].sel(chromophore=name).to_numpy().tolist(),
            strict=True,
        )
        if np.isfinite(y)
    ]
    return ("chromophore", "wavelength_nm", "absorption_per_cm"), out


def provenance(config: OpticsExperiment) -> Made:
    """Every dataset, and what it was used for."""
    uses: dict[str, list[str]] = {}
    for c in config.chromophore:
        uses.setdefault(c.dataset, []).append(c.label)
    return sources(uses)


def _each(data: xr.Dataset) -> list[tuple[tuple[str, float], Any]]:
    return [
        ((str(p), float(r)), data.sel(particle=p, radius=r))
        for p in data["particle"].to_numpy()
        for r in data["radius"].to_numpy()
    ]
