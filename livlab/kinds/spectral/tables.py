"""The CSV tables of a spectral run: columns, and rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import xarray as xr

from livlab import datasets
from livlab.kinds.spectral.claims import BUDGET, Known, energy_residual
from livlab.model.tissue.readings import Reading, rows
from livlab.model.tissue.spectra import FromDatasets, Spec, names_of
from livlab.model.tissue.table import COLUMNS as TISSUE
from livlab.model.tissue.table import tissue_table
from livlab.model.tissue.tissue import Tissue
from livlab.units import FloatArray

Rows = list[dict[str, object]]
Made = tuple[Sequence[str], Rows]

COSTS = ("stage", "reading", "seconds", "samples", "samples_per_second", "solver", "error", "relative_error")
METRICS = ("criterion", "points", "value", "standard_error", "low_95", "high_95", "bias", "resamples")
_PROVENANCE = ("name", "used_for", "source", "doi", "kind", "uncertainty", "licence", "sha256")


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
            shares = {_BUDGET_NAMES.get(b, b): float(p[k]) for b, p in parts.items()}
            out.append({"reading": name, "wavelength_nm": float(x), **shares, "residual": float(residual[k])})
    return ("reading", "wavelength_nm", *(_BUDGET_NAMES.get(b, b) for b in BUDGET), "residual"), out


def convergence(pieces: dict[str, xr.Dataset]) -> Made:
    """How each reading's error fell while it was sampled: root mean square standard error over the wavelengths."""
    names = ("seconds", "samples", "error")
    out: Rows = []
    for reading, piece in pieces.items():
        columns = [np.atleast_1d(piece.attrs.get(f"trace_{name}", [])).tolist() for name in names]
        out += [{"reading": reading, **dict(zip(names, row, strict=True))} for row in zip(*columns, strict=True)]
    return ("reading", *names), out


def largest_error(piece: xr.Dataset) -> float:
    """The largest error over the wavelengths: of sampling, or what a deterministic solver estimates of its own."""
    return float(piece["error_estimate" if "error_estimate" in piece else "standard_error"].max())


_BUDGET_NAMES = {"reflectance": "diffuse_reflectance"}


def tissue(found: Tissue, under: Iterable[Reading]) -> Made:
    """Every parameter of the tissue as each reading takes it."""
    out: Rows = []
    for reading in under:
        records = tissue_table(found, reading).to_dict("records")
        out += [{"reading": reading.name, **{str(k): v for k, v in r.items()}} for r in records]
    return ("reading", *TISSUE), out


def readings(used: Sequence[Reading], *tissues: Tissue) -> Made:
    """Every row where the thesis cannot be taken at its word, each reading's choice, and if it bears on a tissue."""
    frame = rows(*used)
    bearing = {option for tissue in tissues for option in tissue.options()}
    frame["bears"] = frame["option"].isin(bearing)
    records = frame.astype(object).where(frame.notna(), None).to_dict("records")
    return [str(c) for c in frame.columns], [{str(k): v for k, v in r.items()} for r in records]


def provenance(found: Tissue, under: Iterable[Reading], wavelength_nm: FloatArray, references: Iterable[Known]) -> Made:
    """Every dataset that a number of this run came from, and what it was used for."""
    uses: dict[str, list[str]] = {}

    def add(names: Iterable[str], purpose: str) -> None:
        for name in names:
            purposes = uses.setdefault(name, [])
            if purpose not in purposes:
                purposes.append(purpose)

    for reading in under:
        plain = found.under(reading)
        add(names_of(plain.n_above), "refractive index above")
        add(names_of(plain.n_below), "refractive index below")
        for layer in plain.layers:
            add(names_of(layer.index), f"refractive index of {layer.name}")
            for name, element in layer.elements.items():
                add(_used(element, wavelength_nm), f"{name} of {layer.name}")
    for reference in references:
        if reference.dataset is not None:
            add([reference.spec.dataset], f"reference: {reference.spec.label}")
    out: Rows = []
    for name, purposes in sorted(uses.items()):
        meta = datasets.load(name).meta
        row = (name, "; ".join(purposes), meta.source, meta.doi, meta.kind, meta.uncertainty.text, meta.licence)
        out.append(dict(zip(_PROVENANCE, (*row, meta.sha256), strict=True)))
    return _PROVENANCE, out


def _used(part: Any, wavelength_nm: FloatArray) -> list[str]:
    """Datasets of an element that these wavelengths draw on: of several, the first that covers each."""
    if isinstance(part, FromDatasets):
        left = np.ones(len(wavelength_nm), dtype=bool)
        names = []
        for name in part.datasets:
            low, high = datasets.load(name).range_nm
            here = left & (wavelength_nm >= low) & (wavelength_nm <= high)
            if here.any():
                names.append(name)
                left &= ~here
        # What nobody covers is held at the nearest end, of whichever it is.
        return list(part.datasets) if left.any() else names
    if isinstance(part, dict):
        return [n for x in part.values() for n in _used(x, wavelength_nm)]
    if isinstance(part, Spec):
        inner = [n for key in type(part).model_fields for n in _used(getattr(part, key), wavelength_nm)]
        own = getattr(part, "dataset", None)
        return [*inner, *([own] if isinstance(own, str) else [])]
    return []


def _known(value: Any) -> float | None:
    number = float(value)
    return number if np.isfinite(number) else None
