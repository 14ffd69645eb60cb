"""Read a run folder: the only source a report has."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from livlab.core.files import first_line, readable
from livlab.core.netcdf import NetcdfTrouble, load_netcdf
from livlab.core.toml_text import parse_toml
from livlab.criteria import COLUMNS, FORMER_COLUMNS
from livlab.criteria.limits import measured_tissue
from livlab.criteria.table import completed
from livlab.errors import InputError, LivlabError
from livlab.runs.files import sha256
from livlab.runs.old import as_today

LARGEST_BYTES = 1 << 28
"""Of a table; a run's are some MiB."""

AGAIN = "Run the experiment again with --force."


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
        `claims.csv`; empty when the run claims nothing. Of an older run with the columns of today, told from the names.
    tables
        The other CSV files by stem.
    result, coefficients
        Root and `coefficients` groups of `result.nc`, or None where the run did not get that far.
    former_rule
        Whether its claims were judged by the rule before result version 4, whose verdicts they keep.
    """

    path: Path
    manifest: dict[str, Any]
    config: dict[str, Any]
    config_text: str
    claims: pd.DataFrame
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    result: xr.Dataset | None = None
    coefficients: xr.Dataset | None = None
    former_rule: bool = False

    @property
    def tissue(self) -> str:
        """What organ it is about, as its claims of agreement call it: "liver", "skin"."""
        return measured_tissue(self.config)

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
        manifest = json.loads(_text(manifest_file))
        config_text = _text(config_file)
        config = parse_toml(config_text)
        if not isinstance(manifest, dict):
            raise ValueError("its manifest is no table")
    except (ValueError, RecursionError) as error:
        raise InputError.of("run folder", str(folder), f"is damaged ({first_line(error)})", AGAIN) from error
    tables = {f.stem: _read_csv(f) for f in sorted(folder.glob("*.csv"))}
    written = tables.pop("claims", pd.DataFrame(columns=list(COLUMNS)))
    claims = _claims(written)
    result = _read_group(folder / "result.nc", None)
    if result is not None:
        result = as_today(manifest, "result.nc", result)
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
        former_rule="group" not in written,
    )


def _claims(table: pd.DataFrame) -> pd.DataFrame:
    wanted = COLUMNS if "group" in table else FORMER_COLUMNS
    missing = [c for c in wanted if c not in table.columns]
    if missing:
        raise InputError.of("claims.csv", missing, "lacks these columns", AGAIN)
    if "group" in table:
        return table
    return pd.DataFrame(completed(table.to_dict("records")), columns=list(COLUMNS))


def _text(file: Path) -> str:
    return readable(file, "run folder", LARGEST_BYTES, AGAIN).read_text(encoding="utf-8")


def _read_csv(file: Path) -> pd.DataFrame:
    try:
        plain = readable(file, file.name, LARGEST_BYTES, AGAIN)
        return pd.read_csv(plain, keep_default_na=False, na_values=["", "nan", "NaN"])
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    except InputError:
        raise
    except (ValueError, OverflowError, OSError) as error:
        raise InputError.of(file.name, str(file), f"cannot be read ({first_line(error)})", AGAIN) from error


def damaged(folder: Path, manifest: Mapping[str, Any]) -> list[str]:
    """Files of a finished run that are not as it wrote them, by the manifest's hashes; [] if all are."""
    known = manifest.get("files")
    if manifest.get("status") != "complete" or not isinstance(known, dict) or not known:
        return ["the run is not finished"]
    changed = []
    for name, value in known.items():
        path = beneath(folder, name)
        if path is None or sha256(path) != value:
            changed.append(str(name)[:80])
    return changed


@contextlib.contextmanager
def sound(run: RunData) -> Iterator[None]:
    """Tell damage from a defect: what goes wrong with files that are not as the run wrote them is their fault.

    Raises
    ------
    InputError
        Something was raised inside, and a file was changed, or the run never finished.
    """
    try:
        yield
    except LivlabError:
        raise
    except Exception as error:
        changed = damaged(run.path, run.manifest)
        if not changed:
            raise
        bound = f"cannot be shown ({first_line(error)})"
        raise InputError.of(
            "run folder", str(run.path), f"{bound}; changed since it was written: {', '.join(changed[:5])}", AGAIN
        ) from error


def beneath(folder: Path, name: object) -> Path | None:
    """A plain file of the folder by its name; None for what is none, or lies elsewhere: a path out, or a link out."""
    try:
        path = (folder / str(name)).resolve()
        return path if path.is_relative_to(folder.resolve()) and path.is_file() else None
    except (OSError, ValueError, RuntimeError):
        return None


def _read_group(file: Path, group: str | None) -> xr.Dataset | None:
    if not file.is_file():
        return None
    try:
        return load_netcdf(file, group=group)
    except NetcdfTrouble as error:
        raise InputError.of("result.nc", str(file), f"cannot be read ({error})", AGAIN) from error
