"""Figures of BRDF samples: the sphere as a picture with residuals, polar lobes, cells and holes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from livlab.reports.figures import INK, MARKERS, MUTED, colour, style

INCIDENCES = (0.0, 30.0, 45.0, 60.0, 75.0)
"""Angles of incidence at which lobes are shown, degrees."""

_NEAR_DEG = 4.0
FloatArray = NDArray[np.float64]


def sphere_figure(samples: xr.Dataset, predicted: FloatArray | None, lobes: xr.Dataset | None, title: str) -> Figure:
    """Sphere under one light, its residuals, polar lobes at five angles, and the cells of (θ_h, θ_d).

    Parameters
    ----------
    samples : Dataset
        BRDF samples; the pictures need row, column and light.
    predicted : (sample,) array or None
        A model's BRDF, mean over channels, at the samples.
    lobes : Dataset or None
        `value` (incidence, theta) of the model, degrees, theta < 0 on the light's side.
    title : str
        Heading.
    """
    value = samples["value"].mean("channel").values
    pictured = {"row", "column", "light"} <= set(samples.coords) | set(samples.data_vars)
    rows = 2 if pictured else 1
    with style():
        figure = Figure(figsize=(10.4, 4.0 * rows), facecolor="white", layout="constrained")
        figure.set_layout_engine("constrained", w_pad=0.12, h_pad=0.08)
        figure.suptitle(title, x=0.02, ha="left", fontsize=11, color=INK)
        grid = figure.add_gridspec(rows, 2)
        if pictured:
            _pictures(figure, grid, samples, value, predicted)
        polar = figure.add_subplot(grid[rows - 1, 0], projection="polar")
        _polar(polar, samples, value, lobes)
        _cells(figure, figure.add_subplot(grid[rows - 1, 1]), samples)
        return figure


def lobes_of(evaluate: Callable[[FloatArray, FloatArray], xr.DataArray]) -> xr.Dataset:
    """A fitted BRDF in the plane of incidence, mean over channels, as `sphere_figure` draws it.

    Parameters
    ----------
    evaluate
        Gives (direction, channel) values for directions to the light and to the eye, (direction, 3) each.
    """
    theta = np.linspace(-80.0, 80.0, 161)
    t = np.deg2rad(theta)
    wo = np.stack([-np.sin(t), np.zeros_like(t), np.cos(t)], axis=-1)
    curves = []
    for angle in np.deg2rad(INCIDENCES):
        wi = np.broadcast_to([np.sin(angle), 0.0, np.cos(angle)], wo.shape)
        curves.append(evaluate(wi, wo).mean("channel").values)
    return xr.Dataset(
        {"value": (("incidence", "theta"), np.array(curves))}, {"incidence": list(INCIDENCES), "theta": theta}
    )


def _pictures(figure: Figure, grid: Any, samples: xr.Dataset, value: FloatArray, predicted: FloatArray | None) -> None:
    light = samples["light"].values
    chosen = int(np.bincount(light).argmax())
    mine = light == chosen
    rows, columns = samples["row"].values[mine], samples["column"].values[mine]
    step = int(samples.attrs.get("stride", 1))
    shape = (np.ptp(rows) // step + 1, np.ptp(columns) // step + 1)
    at = ((rows - rows.min()) // step, (columns - columns.min()) // step)
    extent = (columns.min() - step / 2, columns.max() + step / 2, rows.max() + step / 2, rows.min() - step / 2)
    left = figure.add_subplot(grid[0, 0])
    picture = np.full(shape, np.nan)
    picture[at] = value[mine]
    shown = left.imshow(picture, extent=extent, cmap="viridis", vmax=float(np.nanpercentile(value[mine], 99.5)))
    figure.colorbar(shown, ax=left, label="BRDF [1/sr]", shrink=0.85, extend="max")
    left.set(title=f"Light {chosen}: samples", xlabel="column [px]", ylabel="row [px]")
    right = figure.add_subplot(grid[0, 1])
    picture = np.full(shape, np.nan)
    if predicted is None:
        mean = np.full(shape, 0.0)
        number = np.full(shape, 0)
        inside = np.isin(samples["row"].values, rows) & np.isin(samples["column"].values, columns)
        where = (
            (samples["row"].values[inside] - rows.min()) // step,
            (samples["column"].values[inside] - columns.min()) // step,
        )
        np.add.at(mean, where, value[inside])
        np.add.at(number, where, 1)
        overall = np.where(number > 0, mean / np.maximum(number, 1), np.nan)[at]
        picture[at] = 100 * (value[mine] / overall - 1)
        name = "against the mean over lights"
    else:
        picture[at] = 100 * (value[mine] / np.maximum(predicted[mine], 1e-12) - 1)
        name = "residual of the fit"
    limit = max(float(np.nanpercentile(np.abs(picture), 97)), 0.1)
    shown = right.imshow(picture, extent=extent, cmap="RdBu_r", vmin=-limit, vmax=limit)
    figure.colorbar(shown, ax=right, label="difference [%]", shrink=0.85)
    right.set(title=f"Light {chosen}: {name}", xlabel="column [px]", ylabel="row [px]")
    for ax in (left, right):
        ax.grid(visible=False)


def _polar(ax: Any, samples: xr.Dataset, value: FloatArray, lobes: xr.Dataset | None) -> None:
    wi, wo = samples["wi"].values, samples["wo"].values
    theta_i, theta_o = np.rad2deg(samples["theta_i"].values), np.rad2deg(samples["theta_o"].values)
    lateral = wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]
    # In the plane of incidence: sideways by less than four degrees.
    sideways = np.rad2deg(np.arcsin(np.clip(np.abs(wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]), 0, 1)))
    side = np.where(lateral < 0, 1.0, -1.0)
    known = []
    for k, incidence in enumerate(INCIDENCES):
        near = (np.abs(theta_i - incidence) < _NEAR_DEG) & (sideways < _NEAR_DEG)
        if near.any():
            edges = np.arange(-88, 92, 4.0)
            angle = (side * theta_o)[near]
            which = np.digitize(angle, edges)
            found = [(angle[which == b].mean(), np.median(value[near][which == b])) for b in np.unique(which)]
            x, y = np.array(found).T
            known.append(y)
            label = f"{incidence:g}°"
            ax.plot(np.deg2rad(x), y, ls="none", marker=MARKERS[k], ms=3.4, color=colour(k), label=label)
        if lobes is not None:
            curve = lobes["value"].isel(incidence=k)
            ax.plot(np.deg2rad(lobes["theta"]), curve, color=colour(k), lw=1.2)
    ax.set_theta_zero_location("N")
    ax.set_theta_direction(-1)
    ax.set(thetamin=-90, thetamax=90, title="Lobes: BRDF [1/sr] by the eye's angle")
    ax.tick_params(labelsize=8)
    if known:
        top = 1.1 * float(np.nanmax(np.concatenate(known)))
        ax.set_ylim(0, top)
        ax.legend(title="light at", loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, title_fontsize=8)
    else:
        ax.text(0.5, 0.5, "no sample in the plane of incidence", transform=ax.transAxes, ha="center", color=MUTED)


def _cells(figure: Figure, ax: Any, samples: xr.Dataset) -> None:
    edges = np.arange(0, 92, 2.0)
    count, _, _ = np.histogram2d(
        np.rad2deg(samples["theta_h"].values), np.rad2deg(samples["theta_d"].values), bins=(edges, edges)
    )
    limit = np.rad2deg(float(samples.attrs.get("max_angle_rad", np.pi / 2)))
    middle = (edges[:-1] + edges[1:]) / 2
    reachable = middle[:, None] + 0 * middle[None, :] < limit
    # Both directions within the limit of the normal, somewhere on the circle of φ_d.
    reachable &= np.hypot(middle[:, None], middle[None, :]) < limit
    holes = reachable & (count == 0)
    shade = np.where(holes, 1.0, np.nan)
    ax.pcolormesh(edges, edges, shade.T, cmap="Greys", vmin=0, vmax=4, rasterized=True)
    shown = ax.pcolormesh(
        edges, edges, np.where(count > 0, count, np.nan).T, norm=LogNorm(1, max(count.max(), 10)), cmap="viridis",
        rasterized=True,
    )  # fmt: skip
    figure.colorbar(shown, ax=ax, label="samples a cell", shrink=0.85)
    share = float((count[reachable] > 0).mean()) if reachable.any() else 0.0
    ax.set(
        title=f"Cells of 2°: {share:.0%} filled, holes grey", xlabel=r"$\theta_h$ [deg]", ylabel=r"$\theta_d$ [deg]",
        xlim=(0, 90), ylim=(0, 90), xticks=[0, 30, 60, 90], yticks=[0, 30, 60, 90],
    )  # fmt: skip
    ax.grid(visible=False)
