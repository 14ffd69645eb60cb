"""Figures of a BRDF run: where samples lie, lobes, and the cuts that are compared."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from livlab.reports.figures import DASHES, INK, MARKERS, MUTED, colour, style

CHANNEL_COLOURS = {"R": 0, "G": 2, "B": 1}


def half_angle_maps(result: xr.Dataset, names: list[str], dim: str) -> Figure:
    """Rms relative error of the samples in each cell of (θ_h, θ_d), one panel a subject; blank: no sample."""
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    with style():
        figure = Figure(figsize=(7.4, 0.9 + 2.35 * rows))
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        h, d = result["theta_h"].to_numpy(), result["theta_d"].to_numpy()
        step_h, step_d = h[1] - h[0], d[1] - d[0]
        edges = np.append(h - step_h / 2, h[-1] + step_h / 2), np.append(d - step_d / 2, d[-1] + step_d / 2)
        known = result["cell_error"].to_numpy()
        known = 100 * known[np.isfinite(known) & (known > 0)]
        low, high = np.quantile(known, [0.02, 0.98]) if known.size else (0.01, 1.0)
        shown = None
        for ax, name in zip(axes.flat, names, strict=False):
            error = result["cell_error"].sel({dim: name}).transpose("theta_d", "theta_h").to_numpy()
            shown = ax.pcolormesh(
                edges[0], edges[1], np.where(error > 0, error, np.nan) * 100, norm=LogNorm(low, max(high, 2 * low)),
                cmap="viridis", rasterized=True,
            )  # fmt: skip
            ax.set_title(name)
            ax.set(xlim=(0, 90), ylim=(0, 90), xticks=[0, 30, 60, 90], yticks=[0, 30, 60, 90])
        for ax in axes.flat[len(names) :]:
            ax.set_visible(False)
        for ax in axes[:, 0]:
            ax.set_ylabel(r"$\theta_d$ [deg]")
        for k in range(columns):
            below = [axes[r, k] for r in range(rows) if axes[r, k].get_visible()]
            below[-1].set_xlabel(r"$\theta_h$ [deg]")
            below[-1].tick_params(labelbottom=True)
        if shown is not None:
            figure.colorbar(shown, ax=list(axes.flat), label="rms error [%]", shrink=0.85, pad=0.02)
        return figure


def lobes(result: xr.Dataset) -> Figure:
    """Values in the plane of incidence at each angle of incidence: samples, truth, fit; one colour a channel."""
    incidences = result["incidence"].to_numpy()
    columns = min(3, len(incidences))
    rows = -(-len(incidences) // columns)
    line = result["line"].to_numpy()
    channels = [str(c) for c in result["channel"].values]
    values = np.concatenate([result[name].to_numpy().ravel() for name in ("measured", "true")])
    known = values[np.isfinite(values) & (values > 0)]
    wide = known.size > 0 and known.max() > 10 * np.quantile(known, 0.05)
    with style():
        figure = Figure(figsize=(7.4, 1.0 + 2.3 * rows))
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for k, (ax, angle) in enumerate(zip(axes.flat, incidences, strict=False)):
            part = result.isel(incidence=k)
            for c, channel in enumerate(channels):
                tone = colour(CHANNEL_COLOURS.get(channel, c))
                first = k == 0
                true = part["true"].isel(channel=c).to_numpy()
                ax.plot(line, true, color=tone, lw=1.0, label=f"{channel}: bsdf.eval" if first else None)
                ax.plot(
                    part["at_theta"], part["measured"].isel(channel=c), color=tone, ls="none",
                    marker=MARKERS[c], ms=3.2, label=f"{channel}: samples" if first else None,
                )  # fmt: skip
                fitted = part["fitted"].isel(channel=c).to_numpy()
                if np.isfinite(fitted).any():
                    ax.plot(line, fitted, color=tone, ls=DASHES[3], lw=1.6, label=f"{channel}: fit" if first else None)
            ax.axvline(float(angle), color=MUTED, lw=0.8, ls=(0, (2, 3)))
            ax.set_title(f"light at {angle:g}°")
            ax.set(xlim=(-90, 90), xticks=[-60, 0, 60])
            if wide:
                ax.set_yscale("log")
        if not wide and known.size:
            for ax in axes.flat:
                ax.set_ylim(0, 1.15 * known.max())
        _finish(figure, axes, len(incidences), r"eye $\theta_o$ [deg]", "BRDF [1/sr]")
        return figure


def cuts(result: xr.Dataset, scan: str) -> Figure:
    """The compared cut, a row a reading and a column a wavelength: sphere, goniometer and the fitted Nunes form."""
    readings = [str(r) for r in result["reading"].values]
    wavelengths = result["wavelength"].to_numpy()
    x = result["cut_angle"].to_numpy()
    with style():
        figure = Figure(figsize=(7.4, 1.0 + 2.2 * len(readings)))
        axes = figure.subplots(len(readings), len(wavelengths), squeeze=False, sharex=True)
        for r, reading in enumerate(readings):
            for w, nm in enumerate(wavelengths):
                ax = axes[r, w]
                at = {"reading": r, "wavelength": w}
                _with_error(
                    ax, x, result["cut_goniometer"].isel(at), result["cut_goniometer_se"].isel(at), 1, "flat sample"
                )
                _points(ax, x, result["cut_sphere"].isel(at), result["cut_sphere_se"].isel(at), 0, "sphere")
                fitted = result["cut_fit"].isel(at).to_numpy()
                if np.isfinite(fitted).any():
                    ax.plot(x, fitted, color=INK, lw=1.4, ls=DASHES[1], label="Nunes 2017 form, fitted")
                ax.set_title(f"{reading}, {nm:g} nm")
                top = np.nanmax(
                    [np.nanmax(result["cut_goniometer"].isel(at)), np.nanmax(result["cut_sphere"].isel(at))]
                )
                ax.set_ylim(0, 1.3 * top)
        label = (
            r"eye $\theta_o$ [deg], minus: on the light's side" if scan == "incidence" else "light and eye at θ [deg]"
        )
        _finish(figure, axes, len(readings) * len(wavelengths), label, "BRDF [1/sr]")
        return figure


def liver_lobes(result: xr.Dataset, wavelength: int) -> Figure:
    """Values in the plane of incidence at every incidence, one panel a reading: flat sample and sphere."""
    readings = [str(r) for r in result["reading"].values]
    incidences = result["incidence"].to_numpy()
    theta = result["theta"].to_numpy()
    with style():
        columns = min(3, len(readings))
        rows = -(-len(readings) // columns)
        figure = Figure(figsize=(7.4, 0.9 + 2.6 * rows))
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True)
        for r, (ax, reading) in enumerate(zip(axes.flat, readings, strict=False)):
            part = result.isel(reading=r, wavelength=wavelength)
            for k, angle in enumerate(incidences):
                line = part["flat_lobes"].isel(incidence=k).to_numpy()
                label = f"light at {angle:g}°" if r == 0 else None
                ax.plot(theta, line, color=colour(k), ls=DASHES[k % len(DASHES)], lw=1.3, label=label)
                dots = part["sphere_lobes"].isel(incidence=k).to_numpy()
                ax.plot(theta, dots, color=colour(k), ls="none", marker=MARKERS[k % len(MARKERS)], ms=3)
            # A mirror peak of an inner interface would press all else to the floor.
            every = part["flat_lobes"].to_numpy()
            ax.set_ylim(0, 1.25 * float(np.nanquantile(every, 0.96)))
            ax.set(title=reading, xlim=(-90, 90), xticks=[-60, 0, 60])
        _finish(figure, axes, len(readings), r"eye $\theta_o$ [deg], minus: on the light's side", "BRDF [1/sr]")
        return figure


def radii(table: Any) -> Figure:
    """What spheres of several radii return, over what the largest returns."""
    with style():
        figure = Figure(figsize=(7.4, 3.4))
        ax = figure.subplots()
        groups = list(table.groupby(["reading", "wavelength_nm"], sort=False))
        for k, ((reading, nm), part) in enumerate(groups):
            ax.errorbar(
                part["radius_mm"], part["ratio"], 2 * part["ratio_se"], color=colour(k), marker=MARKERS[k % 8],
                ls=DASHES[k % len(DASHES)], capsize=2, label=f"{reading}, {nm:g} nm",
            )  # fmt: skip
        ax.axhline(1.0, color=INK, lw=1)
        ax.set_xscale("log")
        ax.set_xlabel("radius of the sphere [mm]")
        ax.set_ylabel("sphere / largest sphere")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        return figure


def _points(ax: Any, x: Any, y: Any, se: Any, k: int, label: str) -> None:
    ax.errorbar(
        x, y, 2 * np.nan_to_num(se), color=colour(k), marker=MARKERS[k], ms=4, ls="none", capsize=2, label=label
    )


def _with_error(ax: Any, x: Any, y: Any, se: Any, k: int, label: str) -> None:
    y, se = np.asarray(y), np.nan_to_num(se)
    ax.plot(x, y, color=colour(k), label=label)
    ax.fill_between(x, y - 2 * se, y + 2 * se, color=colour(k), alpha=0.25, lw=0)


def _finish(figure: Figure, axes: Any, used: int, x_label: str, y_label: str) -> None:
    handles, labels = axes.flat[0].get_legend_handles_labels()
    rows, columns = axes.shape
    for ax in axes.flat[used:]:
        ax.set_visible(False)
    for k in range(columns):
        below = [axes[r, k] for r in range(rows) if axes[r, k].get_visible()]
        below[-1].tick_params(labelbottom=True)
    figure.supxlabel(x_label, fontsize=10)
    figure.supylabel(y_label, fontsize=10)
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
