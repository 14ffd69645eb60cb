"""The CSV tables of a spectral run: columns, and rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from livlab.kinds.shared.tissue_tables import Made, Rows
from livlab.kinds.spectral.claims import BUDGET, energy_residual

METRICS = ("criterion", "points", "value", "standard_error", "low_95", "high_95", "bias", "resamples")


def spectra(pieces: dict[str, xr.Dataset]) -> Made:
    """What the instrument read, a row a reading and wavelength."""
    out: Rows = []
    for name, piece in pieces.items():
        columns = (piece[c].to_numpy() for c in ("wavelength", "value", "standard_error", "samples"))
        out += [
            {
                "reading": name,
                "wavelength_nm": float(x),
                "reflectance": float(value),
                "standard_error": float(error),
                "samples": int(samples),
            }
            for x, value, error, samples in zip(*columns, strict=True)
        ]
    return ("reading", "wavelength_nm", "reflectance", "standard_error", "samples"), out


def curves(result: xr.Dataset) -> Made:
    """The processed curves of readings and references; reading or reference is empty."""
    out: Rows = []
    grid = result["wavelength_curve"].to_numpy()
    for kind, key, value, error in (
        ("reading", "reading", "curve", "curve_se"),
        ("reference", "reference_name", "reference", "reference_sd"),
    ):
        if value not in result:
            continue
        for name in result[key].to_numpy():
            at = result.sel({key: name})
            for x, y, e in zip(grid, at[value].to_numpy(), at[error].to_numpy(), strict=True):
                out.append({kind: str(name), "wavelength_nm": float(x), "value": _known(y), "error": _known(e)})
    return ("reading", "reference", "wavelength_nm", "value", "error"), out


def coefficients(data: xr.Dataset) -> Made:
    """Absorption and scattering of each element where a layer has it."""
    frame = data[["absorption", "scattering", "anisotropy"]].to_dataframe().reset_index()
    frame = frame.dropna(subset=["absorption", "scattering"], how="all")
    out: Rows = [
        {
            "reading": r["reading"],
            "layer": r["layer"],
            "element": r["element"],
            "wavelength_nm": r["wavelength"],
            "absorption_per_mm": _known(r["absorption"]),
            "scattering_per_mm": _known(r["scattering"]),
            "anisotropy": _known(r["anisotropy"]),
        }
        for r in frame.to_dict("records")
    ]
    columns = ("reading", "layer", "element", "wavelength_nm", "absorption_per_mm", "scattering_per_mm", "anisotropy")
    return columns, out


def budget(pieces: dict[str, xr.Dataset]) -> Made:
    """Where the light went: shares of the incident light, and what is in none of them."""
    out: Rows = []
    for name, piece in pieces.items():
        if any(piece[b].isnull().all() for b in BUDGET):
            continue  # the tracer counts what is read, not the rest
        parts = {b: piece[b].sum("layer") if "layer" in piece[b].dims else piece[b] for b in BUDGET}
        residual = energy_residual(piece)
        for k, x in enumerate(piece["wavelength"].to_numpy()):
            shares = {b: float(p[k]) for b, p in parts.items()}
            out.append({"reading": name, "wavelength_nm": float(x), **shares, "residual": float(residual[k])})
    return ("reading", "wavelength_nm", *BUDGET, "residual"), out


def convergence(pieces: dict[str, xr.Dataset]) -> Made:
    """How each reading's error fell while it was sampled: root mean square standard error over the wavelengths."""
    names = ("seconds", "samples", "error")
    out: Rows = []
    for reading, piece in pieces.items():
        columns = [np.atleast_1d(piece.attrs.get(f"trace_{name}", [])).tolist() for name in names]
        out += [{"reading": reading, **dict(zip(names, row, strict=True))} for row in zip(*columns, strict=True)]
    return ("reading", *names), out


def largest_error(piece: xr.Dataset) -> float:
    """The largest error over the wavelengths: of sampling, and what is known of others."""
    if "systematic" in piece:
        return float(np.hypot(piece["standard_error"], piece["systematic"]).max())
    return float(piece["error_estimate" if "error_estimate" in piece else "standard_error"].max())


def _known(value: Any) -> float | None:
    number = float(value)
    return number if np.isfinite(number) else None
