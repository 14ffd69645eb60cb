"""The report's section on a fit's round trips: how often intervals held the truth, and what cannot be identified."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from livlab.reports.figures import INK, MUTED, RULE, Pictures, colour, style
from livlab.reports.folder import RunData
from livlab.reports.tables import ReportSection, Text, from_frame

WANTED = (0.90, 0.99)
"""Coverage within which intervals of 95 % are called honest."""


def round_trip_section(run: RunData, pictures: Pictures) -> ReportSection:
    """The section; empty where there were no round trips."""
    section = ReportSection("round-trips", "Simulated tissues, fitted: do the intervals hold the truth?")
    table, trips = run.table("round_trip"), run.table("round_trips")
    if not len(table) or not len(trips) or run.result is None:
        return section
    level = float(run.result.attrs["level"])
    said = trips[trips["open"].fillna("") != "both"]
    inside = int(said["inside"].astype(bool).sum())
    lost = table[table["verdict"] == "not identifiable"]["parameter"].tolist()
    pairs = table[table["verdict"] == "not alone"]
    named = (
        f"Not identifiable: {', '.join(lost)}." if lost else "Every parameter is bounded by the data in most tissues."
    )
    together = "".join(
        f" {r.parameter} and {r.partner} correlate beyond 0.95 in {r.together} of {r.tissues} tissues."
        for r in pairs.itertuples()
    )
    tissues = int(trips["tissue"].nunique())
    section.content.extend(
        [
            Text(
                f"{tissues} tissues were drawn between the bounds, simulated by a walk of their own with the "
                f"measurement's noise, and fitted. Of {len(said)} intervals of {level:.0%} that say anything, {inside} "
                f"hold the truth ({inside / max(len(said), 1):.1%}). {named}{together}"
            ),
            from_frame(
                table,
                "Intervals that hold the truth, with the 95 % binomial interval of that share. Normal: those that the "
                "covariance alone would give. Width: median, as a share of the box. Spans: tissues in which the "
                "interval reaches from bound to bound.",
                only=["parameter", "inside", "tissues", "coverage", "coverage_low", "coverage_high", "normal_coverage",
                      "width", "spans", "verdict"],
                titles={"coverage_low": "from", "coverage_high": "to", "normal_coverage": "normal",
                        "inside": "hold it"},
            ),
            pictures.add("round-trip-coverage", coverage(table, level), "Share of intervals that hold the truth."),
            pictures.add(
                "round-trip-values",
                values(trips),
                "Fitted values over true ones with their intervals; those that miss the truth are marked.",
            ),
            from_frame(trips, "Every tissue.", folded="Every tissue and parameter"),
        ]
    )  # fmt: skip
    return section


def coverage(table: pd.DataFrame, level: float) -> Figure:
    """Coverage of each parameter's intervals, with its binomial interval, over the band that is wanted."""
    with style():
        figure = Figure(figsize=(7.4, 1.2 + 0.42 * len(table)))
        ax = figure.subplots()
        ax.axvspan(*WANTED, color=RULE, alpha=0.6, lw=0)
        ax.axvline(level, color=INK, lw=1)
        for k, row in enumerate(table.itertuples()):
            ax.plot([float(row.coverage_low), float(row.coverage_high)], [k, k], color=colour(0), lw=3)  # type: ignore[arg-type]
            ax.plot(float(row.coverage), k, "o", color=colour(0), ms=7, label="profile likelihood" if k == 0 else None)  # type: ignore[arg-type]
            if np.isfinite(float(row.normal_coverage)):  # type: ignore[arg-type]
                ax.plot(float(row.normal_coverage), k, "D", color=colour(1), ms=5, label="normal" if k == 0 else None)  # type: ignore[arg-type]
        ax.set_yticks(range(len(table)), [str(n) for n in table["parameter"]])
        ax.set_ylim(len(table) - 0.5, -0.5)
        ax.set_xlim(min(0.5, float(table["coverage_low"].min()) - 0.02), 1.01)
        ax.set_xlabel(f"share that holds the truth; line: {level:.0%}, shaded: {WANTED[0]:.0%}–{WANTED[1]:.0%}")
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        return figure


def values(trips: pd.DataFrame) -> Figure:
    """Fitted values over true ones, a panel a parameter."""
    names = list(dict.fromkeys(str(n) for n in trips["parameter"]))
    columns = min(2, len(names))
    rows = -(-len(names) // columns)
    with style():
        figure = Figure(figsize=(7.4, 3.1 * rows))
        axes = np.ravel(figure.subplots(rows, columns, squeeze=False))
        for ax, name in zip(axes, names, strict=False):
            part = trips[trips["parameter"] == name]
            truth, value = part["truth"].to_numpy(dtype=float), part["value"].to_numpy(dtype=float)
            low, high = part["lower"].to_numpy(dtype=float), part["upper"].to_numpy(dtype=float)
            good = part["inside"].astype(bool).to_numpy()
            ends = [min(truth.min(), low.min()), max(truth.max(), high.max())]
            log = 12.0 * ends[0] < ends[1] < 1e4 * ends[0]
            ax.plot(ends, ends, color=MUTED, lw=1)
            for chosen, tint, mark in ((good, colour(0), "o"), (~good, colour(1), "X")):
                ax.vlines(truth[chosen], low[chosen], high[chosen], color=tint, lw=1.2, alpha=0.6)
                ax.plot(truth[chosen], value[chosen], mark, color=tint, ms=4 if mark == "o" else 7, ls="")
            if log:
                ax.set_xscale("log")
                ax.set_yscale("log")
                ax.xaxis.set_minor_formatter(NullFormatter())
                ax.yaxis.set_minor_formatter(NullFormatter())
            ax.set_title(name, loc="left")
            ax.set_xlabel("truth")
            ax.set_ylabel("fitted")
        for ax in axes[len(names) :]:
            ax.set_visible(False)
        return figure
