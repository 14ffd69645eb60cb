"""The catalogue: where datasets live, loading them with their hash checked, and what is not to be had."""

from __future__ import annotations

import csv
import difflib
import hashlib
import io
import os
import re
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np

from livlab.datasets.dataset import Dataset
from livlab.datasets.meta import (
    NAME_PATTERN,
    WAVELENGTH,
    DatasetMeta,
    Unavailable,
    check_name,
    read_meta,
    read_unavailable,
)
from livlab.errors import DatasetError, EnvironmentProblem, InputError
from livlab.units import FloatArray

TABLE = "table.csv"
META = "meta.toml"
MAX_BYTES = 64 * 1024 * 1024

_Stamp = tuple[int, int, int]
_cache: dict[Path, tuple[_Stamp, _Stamp, Dataset]] = {}
_cache_lock = threading.Lock()


class ReferenceUnavailable(DatasetError):
    """A reference that no source gives as numbers; a comparison with it is MISSING, never invented."""


@dataclass(frozen=True)
class Check:
    """Result of checking one dataset: no problem means it can be loaded and trusted to be what it says."""

    name: str
    path: Path
    problem: str = ""
    remedy: str = ""

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problem


def builtin_root() -> Path:
    """Folder of livlab's own datasets: inside the installed package, or beside it in a source tree.

    Raises
    ------
    EnvironmentProblem
        If neither is there.
    """
    return _root_beside(__file__)


@lru_cache(maxsize=4)
def _root_beside(module: str) -> Path:
    package = Path(module).resolve().parents[1]
    for candidate in (package / "_data" / "datasets", package.parent / "datasets"):
        if (candidate / "unavailable.toml").is_file():
            return candidate
    raise EnvironmentProblem(
        "livlab's own datasets are not where they were installed.",
        remedy="Install livlab again: pip install --force-reinstall livlab",
    )


def user_root() -> Path | None:
    """Folder of the user's datasets: ``$LIVLAB_DATA``, else the platform's data folder; None if there is no home."""
    override = os.environ.get("LIVLAB_DATA")
    try:
        if override:
            return Path(override).expanduser().resolve()
        import platformdirs

        folder = Path(platformdirs.user_data_dir("livlab", appauthor=False))
    except (OSError, RuntimeError, KeyError, ValueError):
        return None
    return folder / "datasets" if folder.is_absolute() else None


def roots(search: Iterable[str | Path] = ()) -> list[Path]:
    """Folders that are searched, in order: `search` (say, ``datasets`` beside an experiment), the user's, livlab's."""
    user = user_root()
    found: list[Path] = []
    for root in (*map(Path, search), *([user] if user else []), builtin_root()):
        resolved = root.resolve() if "\0" not in str(root) else root
        if resolved not in found:
            found.append(resolved)
    return found


def names(*, search: Iterable[str | Path] = ()) -> list[str]:
    """Names of all datasets that are there, sorted.

    >>> "haemoglobin_prahl" in names()
    True
    """
    return sorted({path.name for root in roots(search) for path in _folders(root)})


def unavailable() -> dict[str, Unavailable]:
    """References that no source gives as numbers, by name (whether or not a user has added one since)."""
    return read_unavailable(builtin_root() / "unavailable.toml")


def load(name: str, *, search: Iterable[str | Path] = ()) -> Dataset:
    """Load a dataset by name, with its hash, columns and range checked.

    Parameters
    ----------
    name
        Name in the catalogue.
    search
        Further folders of datasets, searched before the user's and livlab's own.

    Raises
    ------
    ReferenceUnavailable
        If it is a published reference that no source gives as numbers, and no user added.
    DatasetError
        If it is unknown, damaged, changed since its hash was taken, or means two different tables.
    InputError
        If `name` cannot name a dataset.

    Examples
    --------
    >>> blood = load("haemoglobin_prahl")
    >>> blood.range_nm, blood.unit("hbo2")
    ((250.0, 1000.0), '1/(cm M)')
    """
    paths = _find(name, search)
    first = _load_folder(paths[0])
    for other in paths[1:]:
        if read_meta(other / META).sha256 != first.meta.sha256:
            raise DatasetError(
                f"The name {name} means two different datasets: {paths[0]} and {other}.",
                remedy="Rename or remove one of the two folders; a dataset never stands in for another in silence.",
            )
    return first


def check(name: str, *, search: Iterable[str | Path] = ()) -> Check:
    """Check one dataset: hash, columns, order of wavelengths, range. Nothing is raised for a damaged one."""
    path = _find(name, search)[0]
    try:
        load(name, search=search)
    except (DatasetError, InputError) as error:
        return Check(name, path, error.message, error.remedy)
    return Check(name, path)


def check_all(*, search: Iterable[str | Path] = ()) -> list[Check]:
    """Check every dataset that is there."""
    search = list(search)
    return [check(name, search=search) for name in names(search=search)]


def is_builtin(name: str) -> bool:
    """Whether livlab itself brings a dataset of this name."""
    return (builtin_root() / check_name(name) / META).is_file()


def numeric_problem(header: Sequence[str], columns: dict[str, FloatArray]) -> str:
    """Say what makes columns unfit for a spectrum, or nothing: too few rows, gaps, wavelengths that do not rise."""
    wavelength = columns[WAVELENGTH]
    if len(wavelength) < 2:
        return f"a spectrum needs two rows or more, not {len(wavelength)}"
    for name in header:
        values = columns.get(name)
        if values is not None and not np.isfinite(values).all():
            return f"column {name}, table row {int(np.argmin(np.isfinite(values))) + 1}: not a finite number"
    steps = np.diff(wavelength)
    if not (steps > 0).all():
        row = int(np.argmax(steps <= 0)) + 2
        here, before = wavelength[row - 1], wavelength[row - 2]
        return f"wavelengths must rise, but table row {row} has {here:g} nm after {before:g} nm"
    return ""


def _folders(root: Path) -> list[Path]:
    try:
        # A folder whose name cannot be a dataset's is no part of the catalogue (.adding-*, notes, ...).
        return [p for p in root.iterdir() if re.fullmatch(NAME_PATTERN, p.name) and (p / META).is_file()]
    except OSError:  # absent, unreadable or not a folder: it holds nothing for us
        return []


def _find(name: str, search: Iterable[str | Path]) -> list[Path]:
    check_name(name)
    search = list(search)
    searched = roots(search)
    found = []
    for root in searched:
        try:
            if (root / name / META).is_file():
                found.append(root / name)
        except OSError:
            continue
    if found:
        return found
    missing = unavailable().get(name)
    if missing is not None:
        instead = f" In its place: {missing.instead}." if missing.instead else ""
        raise ReferenceUnavailable(
            f"reference not available: {name} ({missing.title}). {missing.missing}{instead}",
            remedy=f"If you have it as a CSV: {missing.add}",
        )
    near = difflib.get_close_matches(name, [*names(search=search), *unavailable()], n=3)
    hint = f"Did you mean {' or '.join(near)}? " if near else ""
    raise DatasetError(
        f"There is no dataset {name!r} in {', '.join(map(str, searched))}.",
        remedy=f"{hint}livlab data list shows what there is; livlab data add FILE adds one.",
    )


def _stamp(path: Path) -> _Stamp:
    status = path.stat()
    return status.st_mtime_ns, status.st_size, status.st_ino


def _load_folder(folder: Path) -> Dataset:
    try:
        stamps = _stamp(folder / TABLE), _stamp(folder / META)
    except OSError:
        return read_folder(folder)
    with _cache_lock:
        cached = _cache.get(folder)
    if cached is not None and cached[:2] == stamps:
        return cached[2]
    dataset = read_folder(folder)
    with _cache_lock:
        _cache[folder] = (*stamps, dataset)
    return dataset


def read_folder(folder: Path) -> Dataset:
    """Read and check the dataset in a folder, whatever is in the catalogue or in memory.

    Raises
    ------
    DatasetError
        If it is damaged or does not match its hash.
    """
    table_path, meta_path = folder / TABLE, folder / META
    remedy = _remedy(folder)
    meta = read_meta(meta_path)
    if meta.name != folder.name:
        raise DatasetError(
            f"Dataset {folder.name}: its {META} says name = {meta.name!r}.", remedy="Rename the folder or the key."
        )
    try:
        if table_path.stat().st_size > MAX_BYTES:
            raise DatasetError(f"{table_path} is larger than {MAX_BYTES // 2**20} MiB.", remedy=remedy)
        content = table_path.read_bytes()
    except OSError as error:
        raise DatasetError(
            f"Dataset {folder.name}: {table_path} cannot be read: {error.strerror or error}.", remedy=remedy
        ) from error
    digest = hashlib.sha256(content).hexdigest()
    if digest != meta.sha256:
        raise DatasetError(
            f"Dataset {meta.name} has been changed: {table_path} has sha256 {digest[:12]}..., "
            f"its {META} says {meta.sha256[:12]}....",
            remedy=remedy,
        )
    return Dataset(meta=meta, path=folder, columns=MappingProxyType(_parse(content, meta, table_path, remedy)))


def _remedy(folder: Path) -> str:
    if folder.parent == builtin_root():
        return (
            f"Restore livlab's own copy (git checkout -- datasets/{folder.name}, or reinstall livlab). "
            "To use other numbers, add them under another name: livlab data add FILE"
        )
    return (
        f"Put the original file back, or, if the change is meant: "
        f"livlab data add {folder / TABLE} --name {folder.name} --into {folder.parent} --replace"
    )


def _parse(content: bytes, meta: DatasetMeta, path: Path, remedy: str) -> dict[str, FloatArray | tuple[str, ...]]:
    def bad(why: str) -> DatasetError:
        return DatasetError(f"Dataset {meta.name}: {path}: {why}.", remedy=remedy)

    try:
        rows = [row for row in csv.reader(io.StringIO(content.decode("utf-8"), newline="")) if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise bad(f"not a CSV file ({error})") from error
    header, body = (rows[0], rows[1:]) if rows else ([], [])
    if header != list(meta.columns):
        raise bad(f"columns are {', '.join(header) or 'none'}, but {META} describes {', '.join(meta.columns)}")
    if not body:
        raise bad("no rows")
    columns: dict[str, FloatArray | tuple[str, ...]] = {}
    numeric: dict[str, FloatArray] = {}
    for index, (name, column) in enumerate(meta.columns.items()):
        cells = []
        for number, row in enumerate(body, start=1):
            if len(row) != len(header):
                raise bad(f"table row {number} has {len(row)} cells, the heading {len(header)}")
            cells.append(row[index])
        if column.type == "text":
            columns[name] = tuple(cells)
            continue
        try:
            # An empty cell of a parameter table means that the source gives no value.
            values = np.array([float(cell) if cell else np.nan for cell in cells], dtype=np.float64)
        except ValueError as error:
            raise bad(f"column {name}: {error}") from error
        values.flags.writeable = False
        columns[name] = numeric[name] = values
    if meta.range_nm is not None:
        problem = numeric_problem(header, numeric)
        if problem:
            raise bad(problem)
        wavelength = numeric[WAVELENGTH]
        if (wavelength[0], wavelength[-1]) != meta.range_nm:
            raise bad(f"covers {wavelength[0]:g} to {wavelength[-1]:g} nm, but {META} says {meta.range_nm}")
    return columns
