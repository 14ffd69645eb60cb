"""What a dataset says about itself: the model of `meta.toml`, and of the list of references nobody could get."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from livlab.core.files import readable
from livlab.core.toml_text import parse_toml
from livlab.errors import DatasetError, InputError, briefly

Kind = Literal["tabulated", "digitised", "fit", "assumed"]
KINDS: tuple[Kind, ...] = ("tabulated", "digitised", "fit", "assumed")
WAVELENGTH = "wavelength_nm"
NAME_PATTERN = r"[a-z0-9][a-z0-9_-]{0,63}"
COLUMN_PATTERN = r"[A-Za-z][A-Za-z0-9_]{0,63}"
_MAX_META_BYTES = 256 * 1024
_Model = TypeVar("_Model", bound=BaseModel)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, str_strip_whitespace=True)


class ColumnMeta(_Strict):
    """One column: its unit (``1`` for a ratio), what it is, and other names it answers to."""

    unit: str
    description: Annotated[str, Field(min_length=1)]
    type: Literal["number", "text"] = "number"
    aliases: tuple[str, ...] = ()


class Uncertainty(_Strict):
    """What is known of the error: in words, and as a relative number where the source states one."""

    text: Annotated[str, Field(min_length=1)]
    relative: Annotated[float, Field(ge=0)] | None = None


class DatasetMeta(_Strict):
    """The content of ``meta.toml``; an unknown key is an error.

    ``kind`` is *tabulated* (a published table), *digitised* (read off a published figure), *fit* (a published
    formula evaluated) or *assumed*. ``sha256`` is taken over the bytes of ``table.csv``. ``range_nm`` is the
    range that the table covers; a table of parameters has no wavelength column and no range.
    """

    format: Literal[1]
    name: Annotated[str, Field(pattern=f"^{NAME_PATTERN}$")]
    version: Annotated[str, Field(min_length=1)]
    title: Annotated[str, Field(min_length=1)]
    source: Annotated[str, Field(min_length=1)]
    year: Annotated[int, Field(ge=1600, le=2200)] | None = None
    doi: Annotated[str, Field(pattern=r"^10\.\d{4,9}/\S+$")] | None = None
    url: Annotated[str, Field(pattern=r"^https?://\S+$")] | None = None
    kind: Kind
    range_nm: tuple[float, float] | None = None
    licence: Annotated[str, Field(min_length=1)]
    read_in: Annotated[str, Field(min_length=1)]
    notes: str = ""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    uncertainty: Uncertainty
    columns: Annotated[dict[str, ColumnMeta], Field(min_length=1)]

    @model_validator(mode="after")
    def _columns_and_range_fit(self) -> Self:
        seen: set[str] = set()
        for name, column in self.columns.items():
            for known_as in (name, *column.aliases):
                if not re.fullmatch(COLUMN_PATTERN, known_as):
                    raise ValueError(f"column name {known_as!r} must be a letter, then letters, digits or _")
                if known_as in seen:
                    raise ValueError(f"column name {known_as!r} is given twice")
                seen.add(known_as)
        if (WAVELENGTH in self.columns) != (self.range_nm is not None):
            raise ValueError(f"range_nm goes with a column {WAVELENGTH}: give both or neither")
        if self.range_nm is not None:
            if not 0 < self.range_nm[0] < self.range_nm[1]:
                raise ValueError("range_nm must be two rising positive wavelengths")
            if self.columns[WAVELENGTH].unit != "nm" or next(iter(self.columns)) != WAVELENGTH:
                raise ValueError(f"{WAVELENGTH} must be the first column, in nm")
        return self


class Unavailable(_Strict):
    """A reference that a comparison wants and that no source gives as numbers."""

    title: str
    source: str
    doi: str | None = None
    missing: str
    instead: str | None = None
    add: str


class _UnavailableFile(_Strict):
    entries: dict[Annotated[str, Field(pattern=f"^{NAME_PATTERN}$")], Unavailable]


def check_name(name: str) -> str:
    """Return `name` if it can name a dataset: it becomes a folder, so nothing that could leave the catalogue.

    Raises
    ------
    InputError
        If it is empty, too long, or has other characters than a-z, 0-9, ``_`` and ``-``.
    """
    if not isinstance(name, str) or not re.fullmatch(NAME_PATTERN, name):
        raise InputError.of(
            "dataset name",
            name,
            "must be 1 to 64 of a-z, 0-9, _ and -, starting with a letter or digit",
            "Choose a name such as my_liver_2026.",
        )
    return name


def read_meta(path: Path) -> DatasetMeta:
    """Read and validate a ``meta.toml``.

    Raises
    ------
    DatasetError
        If the file is missing, unreadable, not TOML, or does not fit the model; the key and the value are named.
    """
    return _read(path, DatasetMeta)


def read_unavailable(path: Path) -> dict[str, Unavailable]:
    """Read ``unavailable.toml``; an absent file is an empty list."""
    return _read(path, _UnavailableFile, key="entries").entries if path.is_file() else {}


def _read(path: Path, model: type[_Model], *, key: str | None = None) -> _Model:
    remedy = "Restore the file, or add the dataset anew with: livlab data add FILE"
    try:
        readable(path, "dataset", _MAX_META_BYTES, remedy, DatasetError)
        content = parse_toml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror or error}.", remedy=remedy) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path} is not a TOML file: {error}.", remedy=remedy) from error
    try:
        return model.model_validate(content if key is None else {key: content})
    except ValidationError as error:
        raise DatasetError(f"{path}: {describe(error)}.", remedy=remedy) from error


def describe(error: ValidationError) -> str:
    """Say in one line which keys do not fit a model, and why."""
    parts = []
    for item in error.errors(include_url=False)[:5]:
        where = ".".join(str(part) for part in item["loc"]) or "the file"
        why = "unknown key" if item["type"] == "extra_forbidden" else item["msg"].removeprefix("Value error, ")
        plain = item["type"] in {"missing", "extra_forbidden"} or not item["loc"]
        shown = "" if plain else f" = {briefly(item['input']):.60}"
        parts.append(f"{where}{shown}: {why}")
    return "; ".join(parts)
