"""Read a run folder: the only source a report has."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from livlab.errors import InputError

CLAIM_COLUMNS = ("criterion", "value", "standard_error", "reference", "tolerance", "verdict", "seconds")


@dataclass(frozen=True)
class RunData:
    """Everything a report shows, as read from one run folder.

    Attributes
    ----------
    path
        The folder.
    manifest, config
        Parsed `manifest.json` and `config.toml`; `config_text` is the file as written.
    claims
        `claims.csv`; empty when the run claims nothing.
    tables
        The other CSV files by stem.
    result, coefficients
        Root and `coefficients` groups of `result.nc`, or None where the run did not get that far.
    """

    path: Path
    manifest: dict[str, Any]
    config: dict[str, Any]
    config_text: str
    claims: pd.DataFrame
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    result: xr.Dataset | None = None
    coefficients: xr.Dataset | None = None

    @property
    def complete(self) -> bool:
        """Whether the run finished."""
        return self.manifest.get("status") == "complete"

    def table(self, stem: str) -> pd.DataFrame:
        """One of the CSV tables; empty when the run has none of that name."""
        return self.tables.get(stem, pd.DataFrame())


def read_run(folder: Path) -> RunData:
    """Read a run folder.

    Raises
    ------
    InputError
        The folder, its manifest or its config is missing or unreadable.
    """
    folder = Path(folder)
    manifest_file = folder / "manifest.json"
    config_file = folder / "config.toml"
    for needed in (manifest_file, config_file):
        if not needed.is_file():
            raise InputError.of(
                "run folder", str(folder), f"has no {needed.name}", "Name a folder that `livlab run` wrote."
            )
    try:
        manifest = json.loads(manifest_file.read_text(encoding="utf-8"))
        config_text = config_file.read_text(encoding="utf-8")
        config = tomllib.loads(config_text)
    except ValueError as error:
        raise InputError.of(
            "run folder", str(folder), f"is damaged ({error})", "Run the experiment again with --force."
        ) from error
    tables = {f.stem: _read_csv(f) for f in sorted(folder.glob("*.csv"))}
    claims = tables.pop("claims", pd.DataFrame(columns=list(CLAIM_COLUMNS)))
    missing = [c for c in CLAIM_COLUMNS if c not in claims.columns]
    if missing:
        raise InputError.of("claims.csv", missing, "lacks these columns", "Run the experiment again with --force.")
    result = _read_group(folder / "result.nc", None)
    coefficients = _read_group(folder / "result.nc", "coefficients")
    if result is not None and coefficients is not None:
        # A group shares its parent's coordinates in NetCDF; xarray reads one group alone.
        shared = [d for d in coefficients.dims if d not in coefficients.coords and d in result.coords]
        coefficients = coefficients.assign_coords({d: result[d] for d in shared})
    return RunData(
        path=folder,
        manifest=manifest,
        config=config,
        config_text=config_text,
        claims=claims,
        tables=tables,
        result=result,
        coefficients=coefficients,
    )


def _read_csv(file: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(file, keep_default_na=False, na_values=["", "nan", "NaN"])
    except pd.errors.EmptyDataError:
        return pd.DataFrame()


def _read_group(file: Path, group: str | None) -> xr.Dataset | None:
    if not file.is_file():
        return None
    try:
        with xr.open_dataset(file, engine="h5netcdf", group=group) as opened:
            return opened.load()
    except OSError as error:
        if group is not None and "group not found" in str(error).lower():
            return None
        raise InputError.of("result.nc", str(file), f"cannot be read ({error})", "Run again with --force.") from error
    except (KeyError, ValueError):
        return None
