"""Figures of a study: curves coloured by a factor, heat maps, scatter, indices, their settling, what a change does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from livlab.reports.figures import INK, MARKERS, MUTED, RULE, colour, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RAMP = "viridis"
MOST_CURVES = 400
MOST_CELLS = 144
"""Cells of a heat map that still have room for their numbers."""


def curves(result: xr.Dataset, factor: int, logarithmic: bool) -> Figure:
    """Every curve, coloured by one factor; references dashed where the curves are normalised as they are."""
    data = result[f"factor_{factor}"]
    name = str(data.attrs["long_name"])
    x, y = result["wavelength"].to_numpy(), result["reflectance"].to_numpy()
    step = max(1, -(-len(y) // MOST_CURVES))
    with style():
        figure = Figure(figsize=(7.4, 3.8))
        ax = figure.subplots()
        if data.dtype.kind in "fiu":
            values = data.to_numpy().astype(float)
            norm = _norm(values, logarithmic)
            ramp = mpl.colormaps[RAMP]
            for row, value in zip(y[::step], values[::step], strict=True):
                ax.plot(x, row, color=ramp(norm(value)), lw=1.1, alpha=0.8, marker="o" if len(x) == 1 else None)
            unit = str(data.attrs.get("units", "1"))
            label = name if unit == "1" else f"{name} [{unit}]"
            bar = figure.colorbar(mpl.cm.ScalarMappable(norm, ramp), ax=ax, label=label)
            if isinstance(norm, LogNorm):
                bar.set_ticks(_few(values), labels=[f"{v:.2g}" for v in _few(values)])
                bar.minorticks_off()
        else:
            kinds = list(dict.fromkeys(map(str, data.to_numpy())))
            for row, value in zip(y[::step], map(str, data.to_numpy()[::step]), strict=True):
                ax.plot(x, row, color=colour(kinds.index(value)), lw=1.1, alpha=0.7)
            for k, kind in enumerate(kinds):
                ax.plot([], [], color=colour(k), label=kind)
            ax.legend(title=name, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
        ax.set_ylim(bottom=min(0.0, float(np.nanmin(y))))
        ax.set_xlabel("wavelength [nm]")
        ax.set_ylabel("what the instrument reads")
        return figure


def heat(result: xr.Dataset, output: int) -> Figure:
    """One output over a grid of two factors."""
    first, second = (result[f"factor_{k}"] for k in (0, 1))
    data = result[f"output_{output}"]
    frame = pd.DataFrame({"a": first.to_numpy(), "b": second.to_numpy(), "v": data.to_numpy()})
    table = frame.pivot(index="b", columns="a", values="v")
    values = table.to_numpy(dtype=float)
    with style():
        figure = Figure(figsize=(7.4, 4.4))
        ax = figure.subplots()
        image = ax.imshow(values, origin="lower", aspect="auto", cmap=RAMP)
        ax.set_xticks(range(len(table.columns)), [_short(v) for v in table.columns])
        ax.set_yticks(range(len(table.index)), [_short(v) for v in table.index])
        ax.set_xlabel(_axis(first))
        ax.set_ylabel(_axis(second))
        ax.grid(False)
        if values.size <= MOST_CELLS:
            low, high = np.nanmin(values), np.nanmax(values)
            for (i, j), v in np.ndenumerate(values):
                dark = np.isfinite(v) and (v - low) < 0.6 * (high - low)
                text = f"{v:.3g}" if np.isfinite(v) else "–"
                ax.text(j, i, text, ha="center", va="center", fontsize=7, color="white" if dark else "black")
        figure.colorbar(image, ax=ax, label=str(data.attrs["long_name"]))
        return figure


def scatter(result: xr.Dataset, output: int, logarithmic: list[bool]) -> Figure:
    """One output against every factor, panels side by side."""
    factors = _numbered(result, "factor")
    data = result[f"output_{output}"]
    with style():
        columns = min(4, len(factors))
        rows = -(-len(factors) // columns)
        figure = Figure(figsize=(7.4, 0.3 + 2.1 * rows))
        axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for j, factor in enumerate(factors):
            ax = axes.flat[j]
            _points(ax, factor, data.to_numpy(), j, joined=len(factors) == 1)
            if logarithmic[j]:
                ax.set_xscale("log")
                _plain_decades(ax, factor.to_numpy())
            ax.set_xlabel(_axis(factor).replace(" [", "\n[", 1), fontsize=8)
            ax.tick_params(labelsize=7)
        for ax in axes.flat[len(factors) :]:
            ax.set_visible(False)
        for ax in axes[:, 0]:
            ax.set_ylabel(str(data.attrs["long_name"]), fontsize=8)
        return figure


def indices(table: pd.DataFrame) -> Figure:
    """First and total index of each factor, a panel an output, with their intervals; or μ* and σ."""
    last = table[table["points"] == table["points"].max()]
    outputs = list(dict.fromkeys(last["output"]))
    names = list(dict.fromkeys(last["factor"]))
    sobol = "total" in last
    with style():
        columns = min(2, len(outputs))
        rows = -(-len(outputs) // columns)
        figure = Figure(figsize=(7.4, 0.8 + rows * (0.7 + 0.27 * len(names))))
        axes = figure.subplots(rows, columns, squeeze=False, sharey=True, sharex=sobol)
        place = np.arange(len(names))
        pairs = (
            (("first", "first"), ("total", "total")) if sobol else (("mu_star", "mean size μ*"), ("sigma", "spread σ"))
        )
        for k, output in enumerate(outputs):
            ax = axes.flat[k]
            part = last[last["output"] == output].set_index("factor").reindex(names)
            for s, (column, label) in enumerate(pairs):
                half = part.get(f"{column}_interval")
                ax.barh(
                    place + 0.2 * (2 * s - 1), part[column], 0.38, color=colour(1 - s), label=label if k == 0 else None,
                    xerr=None if half is None else half, error_kw={"ecolor": INK, "elinewidth": 0.9, "capsize": 1.5},
                )  # fmt: skip
            ax.axvline(0, color=INK, lw=0.8)
            ax.set_yticks(place, names)
            ax.set_title(output, loc="left")
            ax.grid(False, axis="y")
        axes[0, 0].invert_yaxis()
        for ax in axes.flat[len(outputs) :]:
            ax.set_visible(False)
        for ax in axes[-1]:
            ax.set_xlabel("share of the variance" if sobol else "effect over a factor's range")
        figure.legend(loc="outside upper center", ncols=2)
        return figure


def settling(table: pd.DataFrame) -> Figure:
    """The total index (or μ*) of each factor from a quarter, half and all of the base points."""
    column = "total" if "total" in table else "mu_star"
    outputs = list(dict.fromkeys(table["output"]))
    names = list(dict.fromkeys(table["factor"]))
    with style():
        columns = min(2, len(outputs))
        rows = -(-len(outputs) // columns)
        figure = Figure(figsize=(7.4, 1.4 + 2.1 * rows))
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=column == "total")
        sizes = sorted(table["points"].unique())
        for k, output in enumerate(outputs):
            ax = axes.flat[k]
            for j, name in enumerate(names):
                part = table[(table["output"] == output) & (table["factor"] == name)].sort_values("points")
                shift = 2 ** (0.05 * (j - len(names) / 2))  # side by side, so that the bars can be told apart
                ax.errorbar(
                    part["points"] * shift, part[column], part[f"{column}_interval"], color=colour(j),
                    marker=MARKERS[j % len(MARKERS)], ms=3.5, lw=1, capsize=1.5, label=name if k == 0 else None,
                    mfc="white" if j >= len(MARKERS) else None,
                )  # fmt: skip
            ax.set_xscale("log", base=2)
            ax.set_xticks(sizes, [f"{s:g}" for s in sizes])
            ax.minorticks_off()
            ax.set_title(output, loc="left")
        for ax in axes.flat[len(outputs) :]:
            ax.set_visible(False)
        for ax in axes[-1]:
            ax.set_xlabel("base points")
        axes[0, 0].set_ylabel("total index" if column == "total" else "μ*")
        figure.legend(loc="outside upper center", ncols=3, fontsize=8)
        return figure


def cases(table: pd.DataFrame, outputs: list[str], targets: pd.DataFrame, metrics: Mapping[str, str]) -> Figure:
    """Each output of each case as a point with ±2 standard errors; bands: what is to be explained.

    A Pearson correlation stands on Fisher's scale, artanh ρ, or all that is worth telling apart would lie on its end.
    """
    own = table[table["same_as"].isna()].reset_index(drop=True)
    with style():
        figure = Figure(figsize=(7.4, 0.9 + 0.165 * len(own)))
        axes = figure.subplots(1, len(outputs), sharey=True, squeeze=False)[0]
        place = np.arange(len(own))
        groups = {g: k for k, g in enumerate(dict.fromkeys(own["group"]))}
        for ax, output in zip(axes, outputs, strict=True):
            wanted = targets[targets["output"] == output] if len(targets) else targets
            for t in wanted.to_dict("records"):
                ax.axvspan(t["value"] - t["tolerance"], t["value"] + t["tolerance"], color=MUTED, alpha=0.22, lw=0)
            for group, k in groups.items():
                part = own["group"] == group
                ax.errorbar(
                    own.loc[part, output], place[part], ls="none",
                    xerr=2 * own.loc[part, f"{output} error"].fillna(0.0),
                    marker=MARKERS[k], ms=3.5, color=colour(k), elinewidth=0.9, label=group if ax is axes[0] else None,
                )  # fmt: skip
            if metrics.get(output) == "pearson":
                ax.set_xscale("function", functions=(_fisher, np.tanh))
                ax.set_xlim(-0.98, 0.999)
                ax.set_xticks([-0.9, 0.0, 0.9, 0.99], ["−.9", "0", ".9", ".99"])
            ax.set_title(output, fontsize=9)
            ax.grid(True, axis="y", color=RULE, lw=0.5)
            ax.tick_params(axis="x", labelsize=7)
        axes[0].set_yticks(place, [str(c) for c in own["case"]], fontsize=6.5)
        axes[0].set_ylim(len(own) - 0.4, -0.6)
        figure.legend(loc="outside upper center", ncols=len(groups))
        return figure


def _fisher(value: Any) -> Any:
    return np.arctanh(np.clip(value, -0.9999, 0.9999))


FEW = 40
"""Points up to which each is drawn as a mark that can be seen alone."""


def _points(ax: Axes, factor: xr.DataArray, y: Any, k: int, *, joined: bool = False) -> None:
    few = len(y) <= FEW
    size, alpha = (3.0 if len(y) > 300 else 8.0, 0.5) if not few else (30.0, 1.0)
    if factor.dtype.kind in "fiu":
        x = factor.to_numpy()
        if joined and few:
            order = np.argsort(x, kind="stable")
            ax.plot(x[order], y[order], color=colour(k), lw=1.0)
        ax.scatter(x, y, s=size, color=colour(k), lw=0, alpha=alpha)
        return
    kinds = list(dict.fromkeys(map(str, factor.to_numpy())))
    number = np.array([kinds.index(str(v)) for v in factor.to_numpy()], dtype=float)
    jitter = np.random.default_rng(0).uniform(-0.25, 0.25, len(number))
    ax.scatter(number + jitter, y, s=size, color=colour(k), lw=0, alpha=alpha)
    ax.set_xticks(range(len(kinds)), kinds, fontsize=7, rotation=25, ha="right")


def _numbered(result: xr.Dataset, what: str) -> list[xr.DataArray]:
    found: list[xr.DataArray] = []
    while f"{what}_{len(found)}" in result:
        found.append(result[f"{what}_{len(found)}"])
    return found


def _few(values: Any) -> list[float]:
    """Round numbers, even in the logarithm."""
    low, high = 0.98 * float(np.nanmin(values)), 1.02 * float(np.nanmax(values))
    found = [m * 10.0**e for e in range(-12, 13) for m in (1, 2, 5) if low <= m * 10.0**e <= high]
    return found if len(found) <= 7 else found[:: -(-len(found) // 7)]


def _plain_decades(ax: Axes, values: Any) -> None:
    ax.set_xticks(_few(values), [f"{v:.2g}" for v in _few(values)])
    ax.minorticks_off()


def _norm(values: Any, logarithmic: bool) -> Normalize:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return LogNorm(low, high) if logarithmic and low > 0 else Normalize(low, high)


def _axis(data: xr.DataArray) -> str:
    unit = str(data.attrs.get("units", "1"))
    name = str(data.attrs["long_name"])
    return name if unit == "1" else f"{name} [{unit}]"


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, int | float) else str(value)
