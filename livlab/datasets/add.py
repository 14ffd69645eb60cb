"""Write a user's table into the catalogue: whole under its name, or not at all."""

from __future__ import annotations

import csv
import errno
import hashlib
import io
import os
import shutil
import tempfile
from pathlib import Path

from pydantic import ValidationError

from livlab.datasets import catalogue
from livlab.datasets.draft import Draft
from livlab.datasets.meta import WAVELENGTH, DatasetMeta, check_name, describe, read_meta
from livlab.errors import DatasetError, EnvironmentProblem, InputError


def add(
    draft: Draft,
    *,
    name: str,
    title: str,
    source: str,
    kind: str,
    doi: str | None = None,
    year: int | None = None,
    licence: str = "not stated",
    uncertainty: str = "not stated",
    relative_uncertainty: float | None = None,
    notes: str = "",
    into: Path | None = None,
    replace_existing: bool = False,
) -> Path:
    """Write a draft as dataset `name`; afterwards `livlab.datasets.load` knows it.

    The folder appears whole under its name or not at all, whatever fails on the way.

    Returns
    -------
    Path
        The dataset's folder.

    Raises
    ------
    InputError
        If the name is taken or not valid, or a piece of metadata does not fit.
    EnvironmentProblem
        If the folder cannot be written (permission, read-only, no space, no home).
    """
    root = _target_root(into)
    target = root / free_name(name, into, replace_existing=replace_existing)
    content = _csv(draft)
    wavelengths = draft.columns.get(WAVELENGTH)
    unit_missing = [column for column, unit in draft.units.items() if unit is None]
    if unit_missing:
        raise InputError.of(
            "unit", None, f"is missing for column {unit_missing[0]}", "Give it: --unit UNIT (1 = ratio)."
        )
    fields = {
        "format": 1,
        "name": name,
        "version": _next_version(target),
        "title": title,
        "source": source,
        "year": year,
        "doi": doi or None,
        "kind": kind,
        "range_nm": None if wavelengths is None else (float(wavelengths[0]), float(wavelengths[-1])),
        "licence": licence,
        "read_in": f"user's file {draft.source_file.name.encode('utf-8', 'replace').decode()}",
        "notes": notes,
        "sha256": hashlib.sha256(content).hexdigest(),
        "uncertainty": {"text": uncertainty, "relative": relative_uncertainty},
        "columns": {
            column: {"unit": unit, "description": _description(draft, column)} for column, unit in draft.units.items()
        },
    }
    try:
        meta = DatasetMeta.model_validate(fields)
    except ValidationError as error:
        raise InputError(
            f"metadata: {describe(error)}.", remedy="Correct that entry; see livlab data add --help."
        ) from error
    try:
        root.mkdir(parents=True, exist_ok=True)
        _write(root, target, content, meta)
    except OSError as error:
        raise _cannot_write(root, error) from error
    return target


def _description(draft: Draft, column: str) -> str:
    if column == WAVELENGTH:
        return "wavelength"
    return draft.headings.get(column, "").strip() or column.replace("_", " ")


def existing_meta(name: str, into: Path | None = None) -> DatasetMeta | None:
    """Metadata of the dataset that an `add` of `name` would replace; None if there is none that can be read."""
    try:
        return read_meta(_target_root(into) / check_name(name) / catalogue.META)
    except DatasetError:
        return None


def _csv(draft: Draft) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(draft.columns)
    writer.writerows([repr(float(v)) for v in row] for row in zip(*draft.columns.values(), strict=True))
    return text.getvalue().encode()


def _target_root(into: Path | None) -> Path:
    root = into.expanduser().resolve() if into is not None else catalogue.user_root()
    if root is None:
        raise EnvironmentProblem(
            "There is no home folder to keep your datasets in.",
            remedy="Set LIVLAB_DATA to a folder, or give one with --into DIR.",
        )
    if root == catalogue.builtin_root():
        raise InputError.of(
            "--into", str(root), "is where livlab's own datasets are", "Leave --into out, or give another folder."
        )
    return root


def free_name(name: str, into: Path | None = None, *, replace_existing: bool = False) -> str:
    """Return `name` if a dataset may be added under it.

    Raises
    ------
    InputError
        If it is not valid, is one of livlab's own, or is taken and not to be replaced.
    """
    check_name(name)
    if catalogue.is_builtin(name):
        raise InputError.of("name", name, "is one of livlab's own datasets", "Choose another name.")
    root = _target_root(into)
    if os.path.lexists(root / name) and not replace_existing:
        raise InputError.of("name", name, f"is taken in {root}", "Choose another name, or add --replace.")
    return name


def _next_version(target: Path) -> str:
    try:
        old = read_meta(target / catalogue.META).version
    except DatasetError:
        return "1"
    return str(int(old) + 1) if old.isdecimal() else "1"


def _write(root: Path, target: Path, content: bytes, meta: DatasetMeta) -> None:
    import tomli_w

    work = Path(tempfile.mkdtemp(prefix=".adding-", dir=root))
    try:
        staged = work / target.name
        staged.mkdir()
        text = tomli_w.dumps(meta.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
        for file, data in ((catalogue.TABLE, content), (catalogue.META, text.encode())):
            with (staged / file).open("wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
        catalogue.read_folder(staged)
        if os.path.lexists(target):
            target.rename(work / "old")
            try:
                staged.rename(target)
            except OSError:
                (work / "old").rename(target)
                raise
        else:
            staged.rename(target)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _cannot_write(root: Path, error: OSError) -> EnvironmentProblem:
    remedies = {
        errno.ENOSPC: "Free some space there, or choose another folder: --into DIR or LIVLAB_DATA.",
        errno.EDQUOT: "Your quota is used up there: choose another folder with --into DIR or LIVLAB_DATA.",
    }
    return EnvironmentProblem(
        f"The dataset cannot be written to {root}: {error.strerror or error}. Nothing was changed.",
        remedy=remedies.get(error.errno or 0, "Choose a folder that you may write to: --into DIR or LIVLAB_DATA."),
    )
