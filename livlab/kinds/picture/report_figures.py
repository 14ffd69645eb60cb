"""Figures of a picture run: colours, absorption, error against time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from livlab.reports.figures import DASHES, INK, MARKERS, MUTED, RULE, colour, style

PRIMARIES_NM = (700.0, 546.1, 435.8)
"""Red, green and blue of Nunes 2019, eq. 6.20."""


def plain_log(axis: Any) -> None:
    """Ticks of a logarithmic axis as plain numbers, 1, 2 and 5 of each power of ten."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def name_of(row: Any, own: str = "") -> str:
    """A picture's name: its reading, before it the tissue (`own`: what the run's own is called, if anything)."""
    tissue = row.get("tissue")
    tissue = tissue if isinstance(tissue, str) and tissue else own
    return f"{tissue}, {row['reading']}" if isinstance(tissue, str) and tissue else str(row["reading"])


def tissues(table: pd.DataFrame, own: str = "") -> pd.Series[str]:
    """Names of the tissues; the run's own has none in the tables."""
    return table["tissue"].astype(object).where(table["tissue"].notna(), own)


def colours(table: pd.DataFrame, own: str = "") -> Figure:
    """Mean colours: a patch each, and a*, b* and L* with ±2 standard errors."""
    rows = [{str(k): v for k, v in r.items()} for r in table.to_dict("records")]
    names = [name_of(r, own) + (f" ({r['route']})" if table["route"].nunique() > 1 else "") for r in rows]
    with style():
        figure = Figure(figsize=(7.4, max(3.2, 0.36 * len(rows) + 0.8)))
        left, right = figure.subplots(1, 2, width_ratios=[1.3, 1.0])
        for k, row in enumerate(rows):
            left.barh(k, 1.0, height=0.86, color=row["sRGB"], edgecolor=RULE, lw=0.8)
            left.annotate(f"{k + 1}", (-0.06, k), ha="right", va="center", fontsize=8.5, color=INK)
            left.annotate(f"{names[k]}, L* {row['L']:.0f}", (1.1, k), ha="left", va="center", fontsize=8.5, color=INK)
            right.errorbar(
                row["a"], row["b"], 2 * row["b_se"], 2 * row["a_se"], marker=MARKERS[k % len(MARKERS)], ms=8,
                color=MUTED, mfc=row["sRGB"], mec=INK, mew=0.8, ls="none",
            )  # fmt: skip
            right.annotate(
                str(k + 1), (row["a"], row["b"]), xytext=(6, 4), textcoords="offset points", fontsize=8.5, color=INK
            )
        left.set(xlim=(-0.3, 3.6), ylim=(len(rows) - 0.4, -0.6), xticks=[], yticks=[])
        left.grid(False)
        for side in left.spines.values():
            side.set_visible(False)
        right.axhline(0, color=RULE, lw=1, zorder=0)
        right.axvline(0, color=RULE, lw=1, zorder=0)
        right.set_xlabel("a* (green – red)")
        right.set_ylabel("b* (blue – yellow)")
        return figure


def absorption(table: pd.DataFrame, own: str = "") -> Figure:
    """Absorption coefficient of the last layer over wavelength, one curve a picture, in 1/mm."""
    with style():
        figure = Figure(figsize=(7.4, 3.8))
        ax = figure.subplots()
        whole = table[table["element"] == "all"].assign(tissue=tissues(table, own))
        grid = sorted(whole["wavelength_nm"].unique())
        merged = _merged(whole)
        for k, (label, values) in enumerate(merged):
            ax.plot(grid, values, color=colour(k), ls=DASHES[k % len(DASHES)], label=label)
        for x in PRIMARIES_NM:
            ax.axvline(x, color=MUTED, lw=0.8, ls=(0, (1, 2)), zorder=0)
        ax.set_yscale("log")
        plain_log(ax.yaxis)
        ax.set_xlabel("wavelength [nm]")
        ax.set_ylabel("absorption coefficient [1/mm]")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
        return figure


def _merged(whole: pd.DataFrame) -> list[tuple[str, list[float]]]:
    """Curves by tissue; readings of a tissue that absorb alike share one."""
    found: list[tuple[str, list[str], list[float]]] = []
    for (tissue, reading), rows in whole.groupby(["tissue", "reading"], sort=False):
        values = [float(v) for v in rows.sort_values("wavelength_nm")["absorption_per_mm"]]
        for known, readings, curve in found:
            if known == tissue and np.allclose(curve, values, rtol=1e-6):
                readings.append(str(reading))
                break
        else:
            found.append((str(tissue), [str(reading)], values))
    every = whole["reading"].nunique()
    made = []
    for tissue, readings, curve in found:
        who = "every reading" if len(readings) == every > 1 else ", ".join(readings)
        made.append((f"{tissue}: {who}" if tissue else who, curve))
    return made


def convergence(table: pd.DataFrame, own: str = "") -> Figure:
    """Error of each picture against time, with a guide of slope −1/2."""
    with style():
        figure = Figure(figsize=(7.4, 3.6))
        ax = figure.subplots()
        whole = table.assign(tissue=tissues(table, own))
        for k, ((tissue, reading), rows) in enumerate(whole.groupby(["tissue", "reading"], sort=False)):
            label = name_of({"tissue": tissue, "reading": reading})
            t, e = rows["seconds"].to_numpy(), 100 * rows["error"].to_numpy()
            ax.plot(t, e, color=colour(k), marker=MARKERS[k % len(MARKERS)], ms=3.5, label=label)
            if len(t) > 1:
                guide = np.geomspace(t[-1], 4 * t[-1], 2)
                ax.plot(guide, e[-1] * (guide / t[-1]) ** -0.5, color=colour(k), lw=1, ls=(0, (4, 3)))
        ax.set_xscale("log")
        ax.set_yscale("log")
        plain_log(ax.xaxis)
        plain_log(ax.yaxis)
        ax.set_xlabel("time [s]")
        ax.set_ylabel("relative standard error [%]")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        return figure


def ways(table: pd.DataFrame) -> Figure:
    """Image error against time of each way of following light: the root mean square, and what most pixels have."""
    shown = {
        "error": "root mean square",
        **({"typical_error": "what most pixels have"} if "typical_error" in table else {}),
    }
    with style():
        figure = Figure(figsize=(7.4, 4.2))
        axes = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
        for ax, (column, title) in zip(axes, shown.items(), strict=True):
            for k, (way, rows) in enumerate(table.groupby("way", sort=False)):
                ax.plot(
                    rows["seconds"], 100 * rows[column], color=colour(k), marker=MARKERS[k % len(MARKERS)],
                    ls=DASHES[k % len(DASHES)], label=str(way),
                )  # fmt: skip
            ax.set_xscale("log")
            ax.set_yscale("log")
            plain_log(ax.xaxis)
            plain_log(ax.yaxis)
            ax.set_title(title, fontsize=9.5, color=INK)
            ax.set_xlabel("time of one picture [s]")
        axes[0].set_ylabel("image error [% of the mean radiance]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
        return figure
