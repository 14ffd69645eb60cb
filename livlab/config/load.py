"""Experiment files: TOML, versioned; an unknown key is an error that names its path and the nearest known key.

What every experiment has (schema, kind, name, title, seed) lives in `livlab.config.schema`; what one kind has lives in
its own folder, named in `livlab.config.kinds`. Nothing heavy is imported: a run that is already done must answer at
once.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError
from pydantic.json_schema import models_json_schema

from livlab.config.errors import explain, nearest
from livlab.config.kinds import KINDS
from livlab.config.schema import SCHEMA, Experiment, S
from livlab.core.toml_text import parse_toml
from livlab.errors import ConfigError, briefly

LARGEST_BYTES = 1 << 20
"""An experiment file is a page or two; a larger one is a mistake (a table named in place of a config, say)."""


def builtin_experiments() -> dict[str, Path]:
    """The experiments that come with livlab, by name: inside the installed package, or beside it in a source tree.

    >>> "spectral" in builtin_experiments()
    True
    """
    package = Path(__file__).resolve().parents[1]
    folders = (package / "_data" / "experiments", package.parent / "experiments")
    folder = next((f for f in folders if f.is_dir()), folders[0])
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_experiment(path: Path | str) -> Experiment:
    """Read, check and return an experiment file, or one of livlab's own by its bare name.

    A preset file that the experiment names (`tissue.preset = "skin.toml"`) is sought beside the experiment first.

    Raises
    ------
    ConfigError
        The file is missing, a directory, too large, not UTF-8, not TOML, or does not fit the schema. The message
        names the file, the line, the key's full path, the value and the bound; the remedy says how to mend it.
    """
    path = Path(path)
    if not path.exists() and path.name == str(path):
        path = builtin_experiments().get(path.name, path)
    return parse_experiment(_read(path), source=str(path), folder=path.parent)


def load_section(path: Path | str, model: type[S]) -> S:
    """Read and check a file of livlab's that is no experiment but has its form: TOML, versioned, no unknown key.

    Raises
    ------
    ConfigError
        As `load_experiment`.
    """
    text, source = _read(Path(path)), str(path)
    data = _toml(text, source)
    _check_schema(source, data)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise explain(error, data, text, model.model_json_schema(by_alias=True), source) from None


def parse_experiment(text: str, *, source: str = "experiment", folder: Path | None = None) -> Experiment:
    r"""Check the text of an experiment file.

    >>> parse_experiment('schema = 1\nkind = "spectrel"', source="a.toml")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    livlab.errors.ConfigError: a.toml: kind = 'spectrel': must be one of .... Did you mean 'spectral'?
    """
    data = _toml(text, source)
    return check_experiment(data if folder is None else _presets_beside(data, folder), source=source, text=text)


def check_experiment(data: Mapping[str, Any], *, source: str = "experiment", text: str | None = None) -> Experiment:
    """Check an experiment that is a table already, as a program makes it.

    Parameters
    ----------
    data
        As TOML would give it. Where no text is given, `schema` may be left out: a program speaks to this livlab.
    source
        What errors call it.
    text
        The file it was read from, so that errors can name lines.

    Raises
    ------
    ConfigError
        What does not fit: the key's full path, the value, the bound and the remedy.

    Examples
    --------
    >>> check_experiment({"name": "a", "kind": "spectrel"})  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    livlab.errors.ConfigError: experiment: kind = 'spectrel': must be one of .... Did you mean 'spectral'?
    """
    data = dict(data) if text is not None else {"schema": SCHEMA, **data}
    _check_schema(source, data)
    kind = data.get("kind", "spectral")
    if not isinstance(kind, str) or kind not in KINDS:
        known = sorted(KINDS)
        hint = nearest(kind if isinstance(kind, str) else "", known)
        bound = f"must be one of {', '.join(known)}"
        raise ConfigError(f"{source}: kind = {briefly(kind)}: {bound}.", remedy=hint or "Pick one.")
    model = KINDS[kind].load_config()
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise explain(error, data, text or "", model.model_json_schema(by_alias=True), source) from None


def to_toml(config: Experiment) -> str:
    """The experiment as TOML, in full; reading it back gives an equal experiment."""
    return tomli_w.dumps(_plain_floats(config.plain()), multiline_strings=True)


def json_schema() -> dict[str, Any]:
    """JSON Schema of an experiment file, for editors that complete and check as one types."""
    # Together, so that what two kinds share is defined once, where "$ref" looks for it.
    refs, shared = models_json_schema([(kind.load_config(), "validation") for kind in KINDS.values()], by_alias=True)
    schema: dict[str, Any] = {"anyOf": list(refs.values()), **shared}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": f"livlab experiment, schema {SCHEMA}",
    }


def _read(path: Path) -> str:
    remedy = "Name an experiment file (TOML), e.g. experiments/spectral.toml."
    try:
        if path.is_dir():
            raise ConfigError(f"{path} is a directory.", remedy=remedy)
        if not path.exists():
            known = [x.name for x in path.parent.glob("*.toml")] if path.parent.is_dir() else []
            near = nearest(path.name, [*known, *builtin_experiments()])
            raise ConfigError(f"{path}: no such file.", remedy=near or remedy)
        if not path.is_file():
            raise ConfigError(f"{path} is not a regular file.", remedy=remedy)
        size = path.stat().st_size
        if size > LARGEST_BYTES:
            raise ConfigError(
                f"{path}: {size / 2**20:.1f} MiB, more than an experiment file's {LARGEST_BYTES / 2**20:g} MiB.",
                remedy=f"{remedy} A table of numbers is added with `livlab data add FILE` and named in the experiment.",
            )
        raw = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read: {error.strerror or error}.", remedy="Check its permissions."
        ) from None
    try:
        return raw.decode("utf-8").removeprefix("\ufeff").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            f"{path}, line {line}: byte 0x{raw[error.start]:02x} is not UTF-8.", remedy="Save the file as UTF-8."
        ) from None


def _presets_beside(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table with each preset file that lies beside the experiment named by its full path, wherever it runs from."""
    made: dict[str, Any] = {}
    for key, value in data.items():
        made[key] = value
        if isinstance(value, dict):
            made[key] = _presets_beside(value, folder)
        elif isinstance(value, list):
            made[key] = [_presets_beside(x, folder) if isinstance(x, dict) else x for x in value]
        elif key == "preset" and isinstance(value, str) and value.endswith(".toml") and "\0" not in value:
            beside = folder / value
            made[key] = str(beside) if beside.is_file() else value
    return made


def _toml(text: str, source: str) -> dict[str, Any]:
    try:
        return parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax(source, text, str(error)) from None


def _syntax(source: str, text: str, message: str) -> ConfigError:
    where = re.search(r"\(at line (\d+), column (\d+)\)", message)
    what = message[: where.start()].strip() if where else message.removesuffix("(at end of document)").strip()
    line, column = (int(where[1]), int(where[2])) if where else (text.count("\n") + 1, 1)
    shown = text.splitlines()[line - 1].strip()[:80] if line <= len(text.splitlines()) else ""
    return ConfigError(
        f"{source}, line {line}, column {column}: not TOML: {what}" + (f", in: {shown}" if shown else "") + ".",
        remedy="Mend the line; strings need quotes, keys need '='.",
    )


def _check_schema(source: str, data: dict[str, Any]) -> None:
    version = data.get("schema")
    if version is None:
        raise ConfigError(
            f"{source}: schema: the key is missing.", remedy=f"Begin the file with the line `schema = {SCHEMA}`."
        )
    if type(version) is not int or version != SCHEMA:
        newer = type(version) is int and version > SCHEMA
        raise ConfigError(
            f"{source}: schema = {briefly(version)}: this livlab reads {SCHEMA}.",
            remedy="Update livlab." if newer else f"Write `schema = {SCHEMA}`; `livlab schema` prints the form.",
        )


def _plain_floats(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain_floats(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain_floats(v) for v in value]
    if isinstance(value, float) and value == 0.0 and math.copysign(1.0, value) < 0:
        return 0.0
    return value
