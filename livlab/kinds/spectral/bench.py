"""The bench's data: one recorded walk, tabulated so that a page can move a tissue's values without a server.

What leaves plane layers depends on the last layer's absorption alone if nothing else is changed; if that layer is
endless, on its absorption over its reduced scattering. So the ledger is asked along that one number at each wavelength,
and a cubic through values and exact slopes carries it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from livlab.acquire.instruments.models import Instrument
from livlab.errors import InputError
from livlab.fitting.forward import LedgerForward
from livlab.model.tissue import chromophores
from livlab.model.tissue.elements.base import Slider
from livlab.model.tissue.optics import optical_stack
from livlab.model.tissue.readings import Reading
from livlab.model.tissue.setting import Setting
from livlab.model.tissue.spectra import refractive_index
from livlab.model.tissue.tissue import Tissue, override
from livlab.units import FloatArray, um_to_mm

NODES = 32
"""Points of a wavelength's table: between them the cubic is within 1e-5 of the ledger (tested)."""

MOST = 201
STEP_NM = 10.0

AMPLITUDES = (0.4, 2.5)
EXPONENTS = (-1.0, 1.0)
DECIMALS = 9


def bench_data(
    tissue: Tissue,
    reading: Reading,
    wavelength_nm: FloatArray,
    instrument: Instrument,
    *,
    references: Sequence[Mapping[str, Any]] = (),
    standard_error: float = 1e-3,
    seed: int = 1,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Everything that a page needs to answer for other blood, oxygen, bile, lipid, vessels and scattering.

    Parameters
    ----------
    tissue, reading, wavelength_nm, instrument
        The scene; the values of the tissue's last layer can be moved.
    references
        Curves to compare with: label, value (W,) (None where unknown).
    standard_error, seed
        Of the recorded walk.

    Returns
    -------
    Plain data for JSON: `sliders` (path, label, unit, low, high, value, log), `rest` (the fraction at `path` is what
    `fixed` and those at `others` leave of 1; None where nothing takes the rest), `parts` (spectra of what absorbs,
    1/mm), `scattering` (1/mm), `table` (nodes of ln x, value, slope, standard error, first and last valid node),
    `references`, `colour` (weights to linear sRGB), and what it cost.

    Raises
    ------
    InputError
        A last layer with nothing to move.
    """
    started = time.perf_counter()
    plain = tissue.under(reading)
    endless = _made_endless(plain, instrument)
    layer = endless.layers[-1]
    grid = np.asarray(wavelength_nm, dtype=np.float64)
    parts, sliders = _parts(endless, reading, grid)
    if not sliders:
        raise InputError.of("tissue", layer.name, "has no value that a bench can move", "Use a layer with blood, say.")
    # The choices are made, so that no reading changes what a slider sets.
    forward = LedgerForward(endless, reading, grid, instrument, (), standard_error=standard_error)
    stack = forward.stack({})
    last = stack.layers[-1]
    g = np.array([sum_g(last, k) for k in range(len(grid))])
    reduced = last.scattering * (1.0 - g)
    thickness = layer.thickness_mm
    free = math.isinf(thickness) and "scattering" in instrument.sliders
    if free:
        sliders += _scattering(endless)
    rest = _rest(endless, sliders)
    least, most = _extremes(parts, sliders, reduced, free)
    sliders = [s for s in sliders if rest is None or s["path"] != rest["path"]]
    white = _with_absorption(forward, stack, WHITER * last.absorption)
    forward.record_stacks(stack, [white], seed=seed, progress=progress)
    table = _table(forward, stack, np.log(least), np.log(most), reduced if free else np.ones_like(reduced))
    return {
        "version": 1,
        "title": f"{tissue.name}, {reading.name}",
        "layer": layer.name,
        "wavelength_nm": _numbers(grid),
        "endless": free,
        "sliders": sliders,
        "rest": rest,
        "parts": parts,
        "scattering_per_mm": _numbers(reduced),
        "law": _law(endless, tissue) if free else None,
        "table": table,
        "references": [dict(r) for r in references],
        "colour": _colour(grid),
        "colour_note": _colour_note(grid),
        "instrument": instrument.kind,
        "reading": reading.name,
        "standard_error": standard_error,
        "photons": int(forward.recordings[-1]["photons"]),  # type: ignore[call-overload]
        "seed": seed,
        "seconds": round(time.perf_counter() - started, 3),
        "digest": forward.ledger.about["digest"] if forward.ledger else "",
    }


def bench_grid(wavelength_nm: FloatArray) -> FloatArray:
    """The band of an experiment in steps of at most 10 nm, 201 at most, so that a curve can be drawn."""
    grid = np.asarray(wavelength_nm, dtype=np.float64)
    low, high = float(grid[0]), float(grid[-1])
    if len(grid) > MOST:
        return np.linspace(low, high, MOST)
    steps = np.diff(grid)
    if len(grid) > 1 and steps.max() <= STEP_NM:
        return grid
    return np.linspace(low, high, max(2, min(MOST, 1 + math.ceil((high - low) / STEP_NM))))


def sum_g(layer: Any, k: int) -> float:
    """Mean cosine of a layer's scattering at the k-th wavelength."""
    shares = [float(i.rate[k] * i.albedo[k]) for i in layer.interactions]
    total = math.fsum(shares)
    turned = math.fsum(s * i.phases[k].anisotropy for s, i in zip(shares, layer.interactions, strict=True) if s > 0)
    return turned / total if total > 0 else 0.0


def _made_endless(plain: Tissue, instrument: Instrument) -> Tissue:
    """The tissue with its last layer endless, where it is thicker than any light gets and nothing has sides."""
    layer = plain.layers[-1]
    if not instrument.scale_free or layer.thickness_mm < ENDLESS_MM:
        return plain
    return override(plain, {f"layers.{layer.name}.thickness_mm": math.inf}, by="bench")


ENDLESS_MM = 50.0
"""A last layer at least this thick is taken as endless in a bench: light that got through it would not be seen."""


def _parts(tissue: Tissue, reading: Reading, grid: FloatArray) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """What absorbs in the last layer, as spectra and the sliders that weigh them; the rest is one fixed spectrum."""
    layer = tissue.layers[-1]
    setting = Setting(grid, refractive_index(layer.index, grid, lambda _: None), reading)
    parts: list[dict[str, Any]] = []
    sliders: list[dict[str, Any]] = []
    known = np.zeros_like(grid)
    for name, element in layer.elements.items():
        found = element.movable_absorption(name, setting)
        if found is None:
            continue
        path = f"layers.{layer.name}.elements.{name}"
        data = {key: _plain(value) for key, value in found.data.items()}
        parts.append({"kind": found.formula, "path": path, **data})
        sliders += [_slider(replace(s, key=f"{path}.{s.key}")) for s in found.sliders]
        known += found.now
    total = optical_stack(tissue, reading, grid).layers[-1].absorption
    parts.append({"kind": "rest", "path": "", "spectrum": _numbers(np.maximum(total - known, 0.0))})
    return parts, sliders


def _plain(value: Any) -> Any:
    """A value of a part's data for JSON: spectra as numbers, words as they are."""
    if isinstance(value, np.ndarray):
        return _numbers(value)
    return [_plain(x) for x in value] if isinstance(value, list) else value


def _slider(s: Slider) -> dict[str, Any]:
    """One slider; its range is widened to hold the value."""
    low, high = min(s.low, s.value if s.value > 0 or not s.log else s.low), max(s.high, s.value)
    return {
        "path": s.key,
        "label": s.label,
        "unit": s.unit,
        "low": low,
        "high": high,
        "value": s.value,
        "log": s.log,
    }


def _rest(tissue: Tissue, sliders: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """How a page works out the fraction of what takes the rest of the last layer; its slider gets the range of that."""
    layer = tissue.layers[-1]
    if layer.rest is None:
        return None
    own = layer.elements[layer.rest]
    root, by_path = f"layers.{layer.name}.elements", {s["path"]: s for s in sliders}
    path = f"{root}.{layer.rest}.{own.share_key()}"
    if path not in by_path:
        return None
    moved, fixed = [], 0.0
    for name, element in layer.elements.items():
        if name != layer.rest and element.budget == own.budget:
            other = f"{root}.{name}.{element.share_key()}"
            fixed += 0.0 if other in by_path else element.share
            moved += [other] if other in by_path else []
    least = max(0.0, 1.0 - fixed - sum(by_path[x]["high"] for x in moved))
    by_path[path] |= {"low": least, "high": 1.0 - fixed - sum(by_path[x]["low"] for x in moved)}
    return {"path": path, "others": moved, "fixed": fixed}


def _scattering(tissue: Tissue) -> list[dict[str, Any]]:
    """Sliders of scattering: a factor, and for a power law a change of the exponent."""
    made = [_slider(Slider("scattering.factor", "scattering, × as it is", *AMPLITUDES, 1.0, log=True))]
    found = [e.movable_scattering() for e in tissue.layers[-1].elements.values()]
    tilts = [x.tilts for x in found if x is not None]
    if tilts and all(tilts):
        made.append(_slider(Slider("scattering.exponent", "scattering exponent, + as it is", *EXPONENTS, 0.0)))
    return made


def _law(tissue: Tissue, whole: Tissue) -> dict[str, Any] | None:
    """How the scattering sliders are written as values of the tissue: a power law at 500 nm, or cells' fraction.

    A scatterer that stands in for another keeps doing so: in the `whole` tissue, before a reading chose, it says for
    which.
    """
    layer, asked = tissue.layers[-1], whole.layers[-1]
    for name, element in layer.elements.items():
        found = element.movable_scattering()
        if found is None or not found.formula:
            continue
        path = ".".join(filter(None, (f"layers.{layer.name}.elements.{name}", found.key)))
        whole_element = {} if found.key else {"replaces": asked.elements[name].stands_in_for}
        return {"kind": found.formula, "path": path, **(found.data or {}), **whole_element}
    return None


def _pigment_range(part: Mapping[str, Any], by_path: _Sliders) -> tuple[FloatArray, FloatArray]:
    f, spectrum = by_path[f"{part['path']}.{part.get('key', 'fraction')}"], np.asarray(part["spectrum"])
    return f["low"] * spectrum, f["high"] * spectrum


def _blood_range(part: Mapping[str, Any], by_path: _Sliders) -> tuple[FloatArray, FloatArray]:
    f, r = by_path[f"{part['path']}.fraction"], by_path[f"{part['path']}.vessel_radius_um"]
    ends = [np.asarray(part[k]) for k in ("deoxy", "oxy")]
    least = np.min([chromophores.blood(1.0, e, um_to_mm(r["high"])) for e in ends], axis=0)
    most = np.max([chromophores.blood(1.0, e, um_to_mm(r["low"])) for e in ends], axis=0)
    return f["low"] * least, f["high"] * most


def _mixture_range(part: Mapping[str, Any], by_path: _Sliders) -> tuple[FloatArray, FloatArray]:
    f, spectra = by_path[f"{part['path']}.fraction"], np.asarray(part["spectra"])
    return f["low"] * spectra.min(axis=0), f["high"] * spectra.max(axis=0)


def _rest_range(part: Mapping[str, Any], by_path: _Sliders) -> tuple[FloatArray, FloatArray]:
    return np.asarray(part["spectrum"]), np.asarray(part["spectrum"])


_Sliders = Mapping[str, Mapping[str, Any]]
_RANGES: Mapping[str, Callable[[Mapping[str, Any], _Sliders], tuple[FloatArray, FloatArray]]] = {
    "pigment": _pigment_range,
    "blood": _blood_range,
    "mixture": _mixture_range,
    "rest": _rest_range,
}
"""Least and most absorption of a part by its formula, over all that its sliders can do."""


def _extremes(
    parts: Sequence[Mapping[str, Any]], sliders: Sequence[Mapping[str, Any]], reduced: FloatArray, free: bool
) -> tuple[FloatArray, FloatArray]:
    """(W,) least and largest of the number along which the ledger is asked, over all that the sliders can do."""
    by_path = {s["path"]: s for s in sliders}
    low, high = np.zeros_like(reduced), np.zeros_like(reduced)
    for part in parts:
        least, most = _RANGES[part["kind"]](part, by_path)
        low, high = low + least, high + most
    if free:
        wide = 2.0 ** EXPONENTS[1]
        low, high = low / (reduced * AMPLITUDES[1] * wide), high / (reduced * AMPLITUDES[0] / wide)
        low = np.maximum(low, LEAST)
    return np.maximum(low, 1e-6), np.maximum(high, 1e-5)


WHITER = 0.3
"""Share of the tissue's own absorption down to which the walk is made to serve: whiter tissue takes ever longer, and a
page shows where the answers end."""

LEAST = 1e-3
"""Least absorption over reduced scattering that a table reaches to."""


def _with_absorption(forward: LedgerForward, stack: Any, absorption: FloatArray) -> Any:
    """The stack with another absorption of its last layer."""
    from livlab.model.tissue.setting import absorber

    last = stack.layers[-1]
    kept = tuple(i for i in last.interactions if (i.albedo > 0).any())
    own = np.zeros_like(absorption)
    for i in kept:
        own = own + i.rate * (1.0 - i.albedo)
    given = absorber("bench", np.maximum(absorption - own, 0.0))
    return replace(stack, layers=(*stack.layers[:-1], replace(last, interactions=(*kept, given))))


def _table(forward: LedgerForward, stack: Any, low: FloatArray, high: FloatArray, per: FloatArray) -> dict[str, Any]:
    """Values, slopes by ln x and errors of the reading at the nodes of each wavelength, and which nodes are valid."""
    size = len(low)
    x = np.exp(low + np.linspace(0.0, 1.0, NODES)[:, None] * (high - low))
    # All nodes of all wavelengths are one question, since a ledger answers many sooner than few.
    every = stack.at(np.tile(np.arange(size), NODES).tolist())
    found = forward.answer_stack(_with_absorption(forward, every, (x * per).ravel()))
    value, error = found.value.reshape(NODES, size), found.standard_error.reshape(NODES, size)
    valid = found.valid.reshape(NODES, size)
    slope = found.slopes["absorption"].reshape(NODES, size) * x * per
    first = [int(np.argmax(v)) if v.any() else -1 for v in valid.T]
    last = [NODES - 1 - int(np.argmax(v[::-1])) if v.any() else -1 for v in valid.T]
    return {
        "low": _numbers(low),
        "high": _numbers(high),
        "nodes": NODES,
        "value": [_numbers(v) for v in value.T],
        "slope": [_numbers(v) for v in slope.T],
        "error": [_numbers(v) for v in error.T],
        "first": first,
        "last": last,
    }


def _colour(grid: FloatArray) -> list[list[float]] | None:
    """(3, W) weights to linear sRGB under D65 for the 2° observer; None where the band is too narrow for a colour."""
    from livlab.errors import RangeError
    from livlab.model.colour import cie_weights

    try:
        weights = cie_weights(grid).transpose("channel", "wavelength").to_numpy()
    except (RangeError, InputError):
        return None
    return [_numbers(row) for row in weights]


def _colour_note(grid: FloatArray) -> str:
    """What the colour shown leaves out of what the eye sees; "" where nobody would see it in a grey."""
    from livlab.errors import RangeError
    from livlab.model.colour import daylight_doubt

    try:
        told = daylight_doubt(grid, np.full(len(grid), 0.3))
    except (RangeError, InputError):
        return ""
    return told and f"The colour shown: for a grey of 30 %, {told}"


def _numbers(values: FloatArray) -> list[float]:
    return [float(f"{v:.{DECIMALS}g}") for v in np.asarray(values, dtype=np.float64)]


__all__ = ["ENDLESS_MM", "NODES", "bench_data", "bench_grid"]
