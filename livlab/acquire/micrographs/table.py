"""Table 6.1's form on file: what `livlab fractions` writes and a tissue preset takes."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from livlab.acquire.micrographs.fractions import LayerTable
from livlab.core.files import readable
from livlab.core.toml_text import parse_toml
from livlab.criteria import round_to_error
from livlab.errors import InputError

LARGEST_BYTES = 1 << 20
"""A table has some dozen lines."""

FIELDS = ("depth_from", "depth_to", "elastin", "elastin_error", "collagen", "collagen_error")
"""Shares of the layer's thickness from the surface, volume fractions and their counting errors, all 0 to 1."""


def table_rows(table: LayerTable) -> list[dict[str, float]]:
    """One dictionary of `FIELDS` a sublayer, from the surface down; digits as the errors support."""
    rows = []
    for k in range(len(table.elastin)):
        row = {"depth_from": round(float(table.edges[k]), 6), "depth_to": round(float(table.edges[k + 1]), 6)}
        for element, values, errors in (
            ("elastin", table.elastin, table.elastin_error),
            ("collagen", table.collagen, table.collagen_error),
        ):
            value, error = float(values[k]), float(errors[k])
            row[element] = round_to_error(value, error)
            row[f"{element}_error"] = round_to_error(error, error)
        rows.append(row)
    return rows


def write_table(path: Path, table: LayerTable) -> None:
    """Write the table as CSV, or as TOML with the layer's `profile` as a preset file has it.

    Raises
    ------
    InputError
        If the suffix is neither .csv nor .toml, or the file cannot be written.
    """
    rows = table_rows(table)
    try:
        if path.suffix == ".csv":
            with path.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.DictWriter(stream, FIELDS)
                writer.writeheader()
                writer.writerows(rows)
        elif path.suffix == ".toml":
            import tomli_w

            path.write_text(tomli_w.dumps({"profile": _profile(rows), "sublayers": rows}), encoding="utf-8")
        else:
            raise InputError.of("output", str(path), "must end in .csv or .toml", "Name it so.")
    except OSError as error:
        raise InputError.of("output", str(path), f"cannot be written ({error.strerror})", "Choose another.") from error


def read_profile(path: Path) -> list[dict[str, Any]]:
    """The `profile` of a tissue layer from a table on file, CSV or TOML, under `FIELDS` (errors optional).

    It goes into a preset by path: `load_preset("liver", changes={"layers.capsule.profile": read_profile(path)})`.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or the sublayers leave a gap or do not run from 0 to 1.
    """
    try:
        text = readable(path, "table", LARGEST_BYTES).read_text(encoding="utf-8-sig")
        if path.suffix == ".toml":
            given = parse_toml(text).get("sublayers", [])
        else:
            given = list(csv.DictReader(text.splitlines()))
        rows = [{key: float(row[key]) for key in FIELDS if key in row or not key.endswith("_error")} for row in given]
    except OSError as error:
        raise InputError.of("table", str(path), f"cannot be read ({error.strerror})", "Check the path.") from error
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, csv.Error) as error:
        raise InputError.of(
            "table",
            str(path),
            f"must hold numbers under {', '.join(FIELDS)} ({error})",
            "Mend it.",
        ) from error
    for row in rows:
        for key, value in row.items():
            if not 0.0 <= value <= 1.0:
                raise InputError.of(f"table, {key}", value, "must lie within 0 to 1", "Mend the table.")
    edges = [row["depth_to"] for row in rows]
    if not rows or [row["depth_from"] for row in rows] != [0.0, *edges[:-1]] or edges[-1] != 1.0:
        raise InputError.of("table", str(path), "sublayers must follow each other from 0 to 1", "Mend the depths.")
    return _profile(rows)


def _profile(rows: list[dict[str, float]]) -> list[dict[str, Any]]:
    return [
        {"to": row["depth_to"], "fractions": {"elastin": row["elastin"], "collagen": row["collagen"]}} for row in rows
    ]
