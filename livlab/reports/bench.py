"""The bench: a report that answers questions. Sliders, curve, colour and error, computed in the page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from livlab.core.files import first_line, readable, write_whole
from livlab.errors import InputError
from livlab.reports.folder import AGAIN, LARGEST_BYTES, RunData
from livlab.reports.tables import ReportSection

FILE = "bench.json"


@dataclass(frozen=True)
class Bench:
    """A bench in a page: safe markup with its data and script."""

    html: Any
    kind: str = "bench"


def bench_markup(data: Mapping[str, Any], name: str = "bench") -> Markup:
    """The bench as a block of HTML, script included; everything that came from a file is escaped.

    Parameters
    ----------
    data
        As `livlab.kinds.spectral.bench.bench_data` makes it.
    name
        Id, one a page.
    """
    text = _environment().get_template("bench.html.j2").render(
        name=name,
        data=data,
        # In a script element only these can end or open anything.
        json=Markup(
            json.dumps(data, separators=(",", ":"), allow_nan=False)
            .replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
        ),
        script=Markup(_asset("bench.js")),
        style=Markup(_asset("bench.css")),
    )  # fmt: skip
    return Markup(text)


def bench_page(data: Mapping[str, Any]) -> str:
    """A page that is a bench alone."""
    return _environment().get_template("bench_page.html.j2").render(
        title=str(data["title"]), css=Markup(_asset("style.css")), bench=bench_markup(data)
    )  # fmt: skip


def write_bench(data: Mapping[str, Any], path: Path) -> Path:
    """Write the page, whole or not at all.

    Raises
    ------
    EnvironmentProblem
        It cannot be written.
    """
    write_whole(path, bench_page(data))
    return path


def read_bench(folder: Path) -> dict[str, Any] | None:
    """The bench of a run folder, or None if it has none.

    Raises
    ------
    InputError
        The file is damaged.
    """
    path = folder / FILE
    if not path.exists():
        return None
    try:
        found = json.loads(readable(path, FILE, LARGEST_BYTES, AGAIN).read_text(encoding="utf-8"))
        if found["version"] != 1 or not found["sliders"] or not found["table"]["value"]:
            raise ValueError("unknown version")
        bench_page(found)
    except InputError:
        raise
    except Exception as error:  # the template asks for what a damaged file may lack
        raise InputError.of(FILE, first_line(error), "is not a bench", AGAIN) from None
    return dict(found)


def bench_section(run: RunData) -> list[ReportSection]:
    """The section of a report, if the run has a bench."""
    found = read_bench(run.path)
    return (
        [ReportSection("bench", "The bench: move the tissue yourself", [Bench(bench_markup(found))])] if found else []
    )


def _asset(name: str) -> str:
    return files("livlab.reports").joinpath(f"templates/{name}").read_text(encoding="utf-8")


def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("livlab.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
