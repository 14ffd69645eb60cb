"""Figures of a fit: curves with what the fit saw and did not see, residuals, intervals, the search."""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from livlab.reports.figures import INK, MARKERS, MUTED, RULE, colour, style


def curves(result: xr.Dataset) -> Figure:
    """Each measured curve with the fitted one, as they were compared, residuals beneath."""
    labels = [str(x) for x in result["measurement"].values]
    with style():
        figure = Figure(figsize=(7.4, 1.1 + 2.5 * len(labels)))
        grid = figure.subplots(2 * len(labels), 1, sharex=True, height_ratios=[2.6, 1.0] * len(labels), squeeze=False)
        axes = grid[:, 0]
        x = result["wavelength"].to_numpy()
        for k, label in enumerate(labels):
            part = result.isel(measurement=k)
            data, sigma, model, start = (part[v].to_numpy() for v in ("data", "sigma", "model", "model_start"))
            top, low = axes[2 * k], axes[2 * k + 1]
            role = "fitted" if str(part["role"].item()) == "fit" else "not seen by the fit"
            top.plot(x, data, color=INK, marker="o", ms=3, lw=1.4, label="measured")
            if np.isfinite(sigma).any():
                low.fill_between(x, -2 * sigma, 2 * sigma, color=MUTED, alpha=0.25, lw=0)
            top.plot(x, start, color=colour(1), ls=(0, (2, 2)), lw=1.2, label="model at the start")
            top.plot(x, model, color=colour(0), lw=2, label="model fitted")
            low.axhline(0, color=INK, lw=0.8)
            low.tick_params(labelbottom=True)
            low.plot(x, model - data, color=colour(0), marker=MARKERS[0], ms=2.5, lw=1)
            top.set_title(f"{label} ({role})", loc="left")
            top.set_ylabel("curve")
            low.set_ylabel("residual")
            if k == 0:
                top.legend(loc="upper left", ncols=1)
        axes[-1].set_xlabel("wavelength [nm]")
        figure.align_ylabels(list(axes))
        return figure


def intervals(table: pd.DataFrame, level: float) -> Figure:
    """Where each parameter lies between its bounds, with its interval."""
    with style():
        figure = Figure(figsize=(7.4, 0.9 + 0.5 * len(table)))
        ax = figure.subplots()
        for k, row in enumerate(table.itertuples()):
            low, high = float(row.low), float(row.high)  # type: ignore[arg-type]
            log = low > 0 and high / low > 5

            def place(value: float, low: float = low, high: float = high, log: bool = log) -> float:
                if log:
                    return float(np.log(max(value, low) / low) / np.log(high / low))
                return (value - low) / (high - low)

            ax.plot([0, 1], [k, k], color=RULE, lw=7, solid_capstyle="butt", zorder=0)
            ends = [float(row.lower), float(row.upper)]  # type: ignore[arg-type]
            if np.isfinite(ends).all():
                ax.plot([place(e) for e in ends], [k, k], color=colour(1), lw=3, solid_capstyle="butt")
            bound = "bound" in str(row.status)
            ax.plot(place(float(row.value)), k, marker="D" if bound else "o", color=colour(0), ms=7)  # type: ignore[arg-type]
            ax.text(-0.01, k + 0.36, f"{low:g}", ha="left", va="center", fontsize=7, color=MUTED)
            ax.text(1.01, k + 0.36, f"{high:g}", ha="right", va="center", fontsize=7, color=MUTED)
        ax.set_yticks(range(len(table)), [str(n) for n in table["parameter"]])
        ax.set_ylim(len(table) - 0.4, -0.6)
        ax.set_xlim(-0.02, 1.02)
        ax.set_xticks([])
        ax.grid(False)
        ax.set_xlabel(f"lower to upper bound; bar: {level:.0%} interval; diamond: at a bound")
        return figure


def path(table: pd.DataFrame) -> Figure:
    """The loss over the evaluations, each recording apart."""
    with style():
        figure = Figure(figsize=(7.4, 3.0))
        ax = figure.subplots()
        begun = 0
        for k, (_, part) in enumerate(table.groupby("recording", sort=True)):
            value = 2.0 * part["value"].to_numpy(dtype=float)
            n = begun + np.arange(len(value))
            good = np.isfinite(value) & (value > 0)
            ax.plot(n[good], value[good], ".", color=colour(k), ms=4)
            best = np.minimum.accumulate(np.where(good, value, np.inf))
            ax.plot(n, np.where(np.isfinite(best), best, np.nan), color=colour(k), label=f"recording {k + 1}")
            begun += len(value)
        ax.set_yscale("log")
        ax.set_xlabel("evaluation")
        ax.set_ylabel("loss Σ r²")
        ax.legend(loc="upper right")
        return figure


def correlation(table: pd.DataFrame) -> Figure:
    """Correlation of the parameters at the optimum."""
    names = [str(x) for x in table["parameter"]]
    matrix = table[names].to_numpy(dtype=float)
    with style():
        size = 1.6 + 0.62 * len(names)
        figure = Figure(figsize=(size + 2.2, size))
        ax = figure.subplots()
        shown = ax.imshow(matrix, vmin=-1, vmax=1, cmap="PuOr")
        for i in range(len(names)):
            for j in range(len(names)):
                value = matrix[i, j]
                red, green, blue, _ = shown.to_rgba(np.nan_to_num(value))
                # Not the page's ink, which turns light on a dark page while the cells stay as they are.
                shade = "#010101" if 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2 > 0.18 else "#fefefe"
                ax.text(j, i, f"{value:.2f}" if np.isfinite(value) else "–", ha="center", va="center", color=shade)
        ax.set_xticks(range(len(names)), names, rotation=35, ha="right")
        ax.set_yticks(range(len(names)), names)
        ax.grid(False)
        return figure
