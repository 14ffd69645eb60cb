"""The CSV tables about a run's tissue: its parameters, its readings, and where every number of it is from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from livlab import datasets
from livlab.kinds.shared.references import Known
from livlab.model.tissue.readings import Reading, rows
from livlab.model.tissue.spectra import FromDatasets, Spec, names_of
from livlab.model.tissue.table import COLUMNS as TISSUE
from livlab.model.tissue.table import tissue_table
from livlab.model.tissue.tissue import Tissue
from livlab.units import FloatArray

Rows = list[dict[str, object]]
Made = tuple[Sequence[str], Rows]

COSTS = ("stage", "reading", "seconds", "samples", "samples_per_second", "solver", "error", "relative_error")
_PROVENANCE = ("name", "used_for", "source", "doi", "kind", "uncertainty", "licence", "sha256")


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
    return sources(uses)


def sources(uses: dict[str, list[str]]) -> Made:
    """A row a dataset: where it is from, and what it was used for (`uses`: purposes by dataset)."""
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
