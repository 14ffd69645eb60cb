"""The tissue's table for reports: every number, its unit, and where it came from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from livlab.errors import RangeError
from livlab.model.tissue.layers import Layer
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.spectra import FromDatasets, Spec, refractive_index
from livlab.model.tissue.tissue import Tissue

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("layer", "thickness_mm", "n_500nm", "element", "parameter", "value", "unit", "source")
_FRACTIONS = {"volume_fraction", "fraction"}


def tissue_table(tissue: Tissue, reading: Reading | None = None) -> pd.DataFrame:
    """Every parameter of a tissue: layer, thickness_mm, n_500nm, element, parameter, value, unit, source.

    Parameters
    ----------
    tissue
        The tissue.
    reading
        If given, the tissue as this reading takes it, with what follows from it (σ_t of cells) as rows of their own.

    Returns
    -------
    A row a parameter, in the tissue's order; the layers' own (thickness, index) have an empty element. n_500nm is
    missing where the layer's index does not reach 500 nm.

    Examples
    --------
    >>> from livlab.model.tissue.presets import load_preset
    >>> table = tissue_table(load_preset("liver"))
    >>> table.query("element == 'blood' and parameter == 'oxygenation'").value.item()
    0.08
    """
    import pandas as pd

    plain = tissue if reading is None else tissue.under(reading)
    made: list[dict[str, Any]] = []
    for layer in plain.layers:
        n = _index_at_500(layer)

        def add(
            element: str, parameter: str, value: Any, unit: str, source: str, name: str = layer.name,
            thickness: float = layer.thickness_mm, n: float = n,
        ) -> None:  # fmt: skip
            made.append(dict(zip(COLUMNS, (name, thickness, n, element, parameter, value, unit, source), strict=True)))

        root = f"layers.{layer.name}"
        add("", "thickness_mm", layer.thickness_mm, "mm", _source(plain, f"{root}.thickness_mm", layer.sources))
        add("", "index", _shown(layer.index), "1", _source(plain, f"{root}.index", layer.sources))
        start = 0.0
        for number, part in enumerate(layer.profile, start=1):
            for name, fraction in part.fractions.items():
                span = f"{start:.0%}–{part.to:.0%} of the depth"
                source = _source(plain, f"{root}.profile", layer.sources)
                add(name, f"volume_fraction, sublayer {number} ({span})", fraction, "1", source)
            start = part.to
        profiled = {name for part in layer.profile for name in part.fractions}
        for name, element in layer.elements.items():
            for x in element.values():
                if name not in profiled or x.key not in _FRACTIONS:
                    source = _source(plain, f"{root}.elements.{name}.{x.key}", element.sources, x.key)
                    add(name, x.label, _shown(x.value), x.unit, source)
            for d in () if reading is None else element.remarks(reading).derived:
                add(name, d.label, d.value, d.unit, d.source)
    return pd.DataFrame(made, columns=list(COLUMNS))


def _source(tissue: Tissue, path: str, sources: dict[str, str], key: str = "") -> str:
    by = next((who for p, who in tissue.given.items() if path == p or path.startswith(f"{p}.")), "")
    printed = sources.get(key or path.rsplit(".", 1)[1], "")
    return f"set by {by}" if by else printed


def _shown(value: Any) -> Any:
    if isinstance(value, FromDatasets):
        return ", then ".join(value.datasets)
    if isinstance(value, Spec):
        return ", ".join(f"{k} {v}" for k, v in value.model_dump().items() if k != "outside")
    return value


def _index_at_500(layer: Layer) -> float:
    try:
        return float(refractive_index(layer.index, np.array([500.0]), lambda _: None)[0])
    except RangeError:
        return float("nan")
