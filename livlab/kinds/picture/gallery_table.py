"""The numbers of several picture runs as one Markdown table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from livlab.errors import InputError
from livlab.reports.folder import RunData, read_run, sound

HEAD = (
    "run", "tissue", "reading", "pixels", "spp", "waves", "seconds", "samples/s", "error", "L*", "a*", "b*", "hue",
    "GiB",
)  # fmt: skip


def picture_table(folders: Sequence[Path]) -> str:
    """What each picture cost and what colour its lit body has, by the run's first colour route.

    Parameters
    ----------
    folders
        Run folders of picture experiments.

    Raises
    ------
    InputError
        A folder that is no finished picture run.
    """
    rows = [HEAD, ("---",) * 3 + ("---:",) * (len(HEAD) - 3)]
    for folder in folders:
        run = read_run(folder)
        with sound(run):
            rows += _rows(run)
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _rows(run: RunData) -> list[tuple[str, ...]]:
    costs, colours = run.table("costs"), run.table("colours")
    if not len(costs) or not (costs["stage"] == "picture").any():
        raise InputError.of("run", str(run.path), "has no finished picture", "Finish it: livlab run FILE.")
    camera = run.config["camera"]
    made = []
    for k, cost in enumerate(costs[costs["stage"] == "picture"].to_dict("records")):
        made.append(
            (
                str(run.manifest.get("name")) if k == 0 else "",
                "" if pd.isna(cost["tissue"]) else str(cost["tissue"]),
                str(cost["reading"]),
                f"{camera['width']} × {camera['height']}",
                f"{cost['spp']:.0f}",
                f"{cost['wavelengths']:.0f}",
                f"{cost['seconds']:.3g}",
                f"{1e-6 * cost['samples_per_second']:.2g} M",
                f"{100 * cost['relative_error']:.1f} %",
                *_colour(colours, {str(k): v for k, v in cost.items()}),
                f"{cost['memory_gib']:.2f}",
            )
        )
    return made


def _colour(colours: pd.DataFrame, cost: dict[str, Any]) -> tuple[str, ...]:
    if not len(colours):
        return ("–",) * 4
    same = (colours["reading"] == cost["reading"]) & (colours["route"] == colours["route"].iloc[0])
    same &= colours["tissue"].isna() if pd.isna(cost["tissue"]) else colours["tissue"] == cost["tissue"]
    found = colours[same].iloc[0]
    return (f"{found['L']:.1f}", f"{found['a']:.1f}", f"{found['b']:.1f}", f"{found['hue']:.0f}°")
