"""Ledgers on disk: NetCDF, read back only if nothing is missing or changed."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from livlab.core.files import first_line
from livlab.core.netcdf import NetcdfTrouble, load_netcdf
from livlab.errors import DatasetError, EnvironmentProblem
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.ledger.data import Anchors, Coefficients, Compression, Entries
from livlab.model.transport.ledger.recording import Recording
from livlab.model.transport.source import Source
from livlab.model.transport.tally import Tally

if TYPE_CHECKING:
    import xarray as xr

R = TypeVar("R", bound=Recording)

FORMAT = "livlab ledger"
VERSION = 1

_ENTRY_TYPES = {
    "anchor": "u2",
    "side": "u1",
    "bin": "i4",
    "features": "f4",
    "log_weight": "f4",
    "concentration": "f4",
    "cosine": "f4",
    "radius": "f4",
}
_SERVED = ("wavelength_nm", "thickness_mm", "absorption", "scattering", "anisotropy", "index")
_ANCHORS = ("wavelength_nm", "scattering", "extinction", "anisotropy", "index", "photons")
_DIMS: dict[str, tuple[str, ...]] = {
    "served_wavelength_nm": ("wavelength",),
    "served_thickness_mm": ("layer",),
    "served_absorption": ("wavelength", "layer"),
    "served_scattering": ("wavelength", "layer"),
    "served_anisotropy": ("wavelength", "layer"),
    "served_index": ("wavelength", "medium"),
    "anchor_wavelength_nm": ("walk",),
    "anchor_scattering": ("walk", "layer"),
    "anchor_extinction": ("walk", "layer"),
    "anchor_anisotropy": ("walk", "layer"),
    "anchor_index": ("walk", "medium"),
    "anchor_photons": ("walk",),
    "anchor": ("entry",),
    "side": ("entry",),
    "bin": ("entry",),
    "features": ("entry", "feature"),
    "log_weight": ("entry",),
    "concentration": ("entry",),
    "paths": ("layer",),
    "bear": ("layer",),
}
_UNITS = {
    "served_wavelength_nm": "nm",
    "anchor_wavelength_nm": "nm",
    "served_thickness_mm": "mm",
    "paths": "mm",
    "served_absorption": "1/mm",
    "served_scattering": "1/mm",
    "anchor_scattering": "1/mm",
    "anchor_extinction": "1/mm",
}
_REMEDY = "Record it anew, or fetch the file again."


def stack_digest(stack: OpticalStack) -> str:
    """SHA-256 over layers, coefficients, indices and mean cosines of a stack sorted by wavelength."""
    found = Coefficients.of(stack)
    digest = hashlib.sha256(json.dumps([x.name for x in stack.layers]).encode())
    for name in _SERVED:
        digest.update(np.ascontiguousarray(getattr(found, name), dtype="<f8").tobytes())
    return digest.hexdigest()


def save(ledger: Recording, path: Path) -> None:
    """Write a ledger; an old file stays until the new one is whole.

    Raises
    ------
    EnvironmentProblem
        The file cannot be written.
    """
    import xarray as xr

    data: dict[str, Any] = {}

    def add(name: str, values: Any, dims: tuple[str, ...]) -> None:
        data[name] = (dims, values, {"units": _UNITS[name]} if name in _UNITS else {})

    for prefix, holder, names in (("served", ledger.served, _SERVED), ("anchor", ledger.anchors, _ANCHORS)):
        for name in names:
            add(f"{prefix}_{name}", getattr(holder, name), _DIMS[f"{prefix}_{name}"])
    for name, values in ledger.entries.arrays().items():
        dims = _DIMS.get(name, ("entry" if len(values) == len(ledger) else "none",))
        add(name, values, dims)
    add("paths", ledger.paths, _DIMS["paths"])
    add("bear", ledger.bear, _DIMS["bear"])
    if ledger.compression is not None:
        add("compression_low", ledger.compression.low, ("walk", "feature"))
        add("compression_high", ledger.compression.high, ("walk", "feature"))
    about: dict[str, Any] = {
        "about": dict(ledger.about),
        "degree": ledger.degree,
        "scaled": ledger.scaled,
        "counted": list(ledger.counted),
        "positions": ledger.positions,
        "depth_bias": ledger.depth_bias,
        "tally": {"theta_edges": ledger.tally.theta_edges, "radius_edges": _plain(ledger.tally.radius_edges)},
        "source": {k: getattr(ledger.source, k) for k in Source.__dataclass_fields__},
        "compression": None
        if ledger.compression is None
        else {k: getattr(ledger.compression, k) for k in ("rows_before", "tolerance", "error")},
    }
    about["about"]["half_width_mm"] = _plain([ledger.about["half_width_mm"]])[0]
    said = json.dumps(about, sort_keys=True)
    attributes = {
        "format": FORMAT,
        "version": VERSION,
        "sha256": _digest({name: x[1] for name, x in data.items()}, said),
        "ledger": said,
        "conventions": "lengths in mm, coefficients in 1/mm; a row counts exp(log_weight + theta . features): path "
        "lengths in each layer, then scatterings in the counted layers; side 0 up, 1 down, 2 side, 3 given up",
    }
    packed = {k: {"zlib": True, "complevel": 4} for k, v in data.items() if v[0][0] == "entry" and len(ledger)}
    temporary = path.with_name(f".{path.name}.part")
    try:
        xr.Dataset(data, attrs=attributes).to_netcdf(temporary, engine="h5netcdf", encoding=packed)
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise EnvironmentProblem(
            f"Cannot write {path}: {error.strerror or error}.", remedy="Check the disk, or name another folder."
        ) from error


def load(path: Path | str, kind: type[R]) -> R:
    """Read a ledger that `save` wrote, as a kind of `Recording`.

    Raises
    ------
    DatasetError
        No such file, not a ledger, one of a later version, or a damaged one.
    """
    path = Path(path)
    if not path.is_file():
        raise DatasetError.of("ledger", str(path), "there is no such file", "Check the path.")
    try:
        found = load_netcdf(path)
    except NetcdfTrouble as error:
        raise DatasetError.of("ledger", path.name, f"cannot be read ({error})", _REMEDY) from error
    assert found is not None
    if not np.array_equal(found.attrs.get("format", ""), FORMAT):
        raise DatasetError.of("ledger", path.name, f"is no {FORMAT}", "Name a file that Ledger.save wrote.")
    if not np.array_equal(found.attrs.get("version", ""), VERSION):
        version = found.attrs.get("version")
        raise DatasetError.of("ledger", path.name, f"has version {version}, this livlab reads {VERSION}", _REMEDY)
    try:
        ledger = _from(found, kind)
    except (LookupError, ValueError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise DatasetError.of("ledger", path.name, f"is damaged ({first_line(error)})", _REMEDY) from error
    held = {str(name): values.to_numpy() for name, values in found.variables.items()}
    if _digest(held, str(found.attrs["ledger"])) != found.attrs.get("sha256"):
        raise DatasetError.of("ledger", path.name, "is damaged (its numbers do not match their checksum)", _REMEDY)
    return ledger


def _from(found: xr.Dataset, kind: type[R]) -> R:
    about = json.loads(found.attrs["ledger"])
    for name, dims in _DIMS.items():
        if found[name].dims != dims:
            raise ValueError(f"{name} has dimensions {found[name].dims}, not {dims}")
    rows = {name: found[name].to_numpy().astype(kind, casting="same_kind") for name, kind in _ENTRY_TYPES.items()}
    entries = Entries(**rows)
    size = found.sizes["entry"]
    if any(len(getattr(entries, n)) not in (size, 0) for n in ("cosine", "radius")):
        raise ValueError("cosine or radius has another length than the rows")
    served = Coefficients(**{n: found[f"served_{n}"].to_numpy().astype(np.float64) for n in _SERVED})
    walks = {n: found[f"anchor_{n}"].to_numpy() for n in _ANCHORS}
    counted = tuple(int(k) for k in about["counted"])
    layers = found.sizes["layer"]
    if found.sizes["feature"] != layers + len(counted) or any(not 0 <= k < layers for k in counted):
        raise ValueError("features do not match the layers")
    if size and int(entries.anchor.max()) >= found.sizes["walk"]:
        raise ValueError("rows of a walk that is not there")
    compression = None
    if about["compression"] is not None:
        bounds = (found["compression_low"].to_numpy(), found["compression_high"].to_numpy())
        compression = Compression(**about["compression"], low=bounds[0], high=bounds[1])
    more = dict(about["about"])
    more["half_width_mm"] = _number(more["half_width_mm"])
    tally = about["tally"]
    return kind(
        entries=entries,
        anchors=Anchors(**walks),
        served=served,
        degree=int(about["degree"]),
        scaled=bool(about["scaled"]),
        counted=counted,
        tally=Tally(tuple(tally["theta_edges"]), tuple(_number(x) for x in tally["radius_edges"])),
        source=Source(**about["source"]),
        positions=bool(about["positions"]),
        paths=found["paths"].to_numpy().astype(np.float64),
        bear=found["bear"].to_numpy().astype(np.float64),
        depth_bias=float(about["depth_bias"]),
        about=more,
        compression=compression,
    )


def _digest(arrays: Mapping[str, Any], said: str) -> str:
    """SHA-256 over all that a file holds."""
    digest = hashlib.sha256(said.encode())
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {values.dtype.newbyteorder('<').str} {values.shape}".encode())
        digest.update(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes())
    return digest.hexdigest()


def _plain(values: Any) -> list[Any]:
    """Infinity as text: JSON has no number for it."""
    return ["inf" if math.isinf(x) else float(x) for x in values]


def _number(value: Any) -> float:
    return math.inf if value == "inf" else float(value)
