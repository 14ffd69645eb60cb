"""Runs of older livlabs: what their files called or judged otherwise, so that they open, and compare, as they were."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from livlab.criteria import FORMER_COLUMNS, read_claims
from livlab.criteria.table import under_former_rule

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Renaming:
    """Variables of a NetCDF file that have another name since a result version.

    Attributes
    ----------
    since
        First result version with today's names.
    kind, file
        Runs of this kind, this file.
    names
        Today's name by the old one.
    """

    since: int
    kind: str
    file: str
    names: Mapping[str, str]


RENAMINGS = (
    Renaming(
        4,
        "brdf",
        "result.nc",
        {"reflectance": "diffuse_reflectance", "reflectance_se": "diffuse_reflectance_se"},
    ),
)


def old_names(manifest: Mapping[str, Any], file: str) -> dict[str, str]:
    """Today's name of what the run calls otherwise in a file, by the run's name.

    >>> old_names({"kind": "brdf", "result_version": 3}, "result.nc")["reflectance"]
    'diffuse_reflectance'
    >>> old_names({"kind": "brdf", "result_version": 4}, "result.nc")
    {}
    """
    version, kind = manifest.get("result_version", 0), manifest.get("kind")
    found: dict[str, str] = {}
    for r in RENAMINGS:
        if r.kind == kind and r.file == file and isinstance(version, int) and version < r.since:
            found |= r.names
    return found


CLAIM_FILES = ("claims.csv", "claims.notes.json")
RULE_SINCE = 4
"""First result version whose verdicts need a distance of two standard errors from the limit."""


def judged_otherwise(manifest: Mapping[str, Any], folder: Path) -> bool:
    """Whether a run's verdicts came about by the former rule: by its result version, and by the table itself."""
    version = manifest.get("result_version", 0)
    if isinstance(version, int) and version < RULE_SINCE:
        return True
    try:
        with (folder / CLAIM_FILES[0]).open(encoding="utf-8") as table:
            return table.readline(1000).strip() == ",".join(FORMER_COLUMNS)
    except (OSError, ValueError):
        return False


def claims_as_then(folder: Path) -> dict[str, bytes]:
    """claims.csv and its notes of a run of today, by name, as the former rule has them; {} if there are none."""
    table = folder / CLAIM_FILES[0]
    return under_former_rule(read_claims(table)) if table.is_file() else {}


def as_today(manifest: Mapping[str, Any], file: str, data: xr.Dataset) -> xr.Dataset:
    """A group of a run's file under today's names."""
    names = old_names(manifest, file)
    return data.rename({old: new for old, new in names.items() if old in data and new not in data})


def as_then(manifest: Mapping[str, Any], file: str, raw: bytes) -> bytes:
    """A file of today under the names that the run of a manifest has: to compare the two byte by byte."""
    names = {new: old for old, new in old_names(manifest, file).items()}
    if not names:
        return raw
    import xarray as xr

    with xr.open_datatree(io.BytesIO(raw), engine="h5netcdf") as tree:
        groups = {node.path: node.to_dataset().load() for node in tree.subtree}
    if not any(new in data for new in names for data in groups.values()):
        return raw
    renamed = {
        path: data.rename({new: old for new, old in names.items() if new in data}) for path, data in groups.items()
    }
    return bytes(xr.DataTree.from_dict(renamed).to_netcdf(None, engine="h5netcdf"))
