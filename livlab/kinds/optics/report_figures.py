"""Figures of an optics run: phase functions, efficiencies, where Rayleigh's law holds, absorption spectra."""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from livlab.reports.figures import DASHES, INK, MUTED, colour, style


def polar(data: xr.Dataset) -> Figure:
    """Phase functions as seen from the particle, each over its own largest value; light comes from the left."""
    particles, radii = _names(data), data["radius"].to_numpy()
    theta = data["theta"].to_numpy()
    around = np.concatenate([theta, theta[::-1][1:] * -1.0])
    with style():
        figure = Figure(figsize=(7.4, 0.6 + 3.3 * len(particles)))
        axes = figure.subplots(len(particles), len(radii), squeeze=False, subplot_kw={"projection": "polar"})
        for i, particle in enumerate(particles):
            for j, radius in enumerate(radii):
                at, ax = data.sel(particle=particle, radius=radius), axes[i, j]
                for k, (name, label) in enumerate((("phase_mie", "Mie"), ("phase_rayleigh", "Rayleigh"))):
                    half = at[name].to_numpy()
                    half = half / half.max()
                    ax.plot(around, np.concatenate([half, half[::-1][1:]]), color=colour(k), ls=DASHES[k], label=label)
                ax.set_title(f"{particle}, r = {radius:g} µm", pad=16)
                ax.set_rticks([0.5, 1.0], ["", ""])
                ax.set_rlim(0, 1.02)
                ax.set_thetagrids(np.arange(0, 360, 45), ["0°", "45°", "90°", "135°", "180°", "135°", "90°", "45°"])
                ax.tick_params(pad=0)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return figure


def phase(data: xr.Dataset) -> Figure:
    """Phase functions against the scattering angle, in 1/sr."""
    figure, axes = _grid(data, "scattering angle [°]", "phase function [1/sr]")
    degrees = np.degrees(data["theta"].to_numpy())
    with style():
        for at, ax in axes:
            for k, (name, label) in enumerate((("phase_mie", "Mie"), ("phase_rayleigh", "Rayleigh"))):
                ax.semilogy(degrees, at[name].to_numpy(), color=colour(k), ls=DASHES[k], label=label)
            ax.set_xticks(np.arange(0, 181, 45))
        _legend(figure, axes)
        return figure


def spectra(data: xr.Dataset) -> Figure:
    """Scattering efficiencies over the wavelengths, each over its own largest value."""
    figure, axes = _grid(data, "wavelength [nm]", "efficiency / its maximum")
    with style():
        for at, ax in axes:
            for k, (name, label) in enumerate((("mie", "Mie"), ("rayleigh", "Rayleigh"))):
                y = at[name].to_numpy()
                ax.plot(at["wavelength"], y / y.max(), color=colour(k), ls=DASHES[k], label=label)
            ax.set_ylim(0, 1.05)
        _legend(figure, axes)
        return figure


def efficiencies(data: xr.Dataset) -> Figure:
    """Scattering efficiencies over the wavelengths, as they are."""
    figure, axes = _grid(data, "wavelength [nm]", "scattering efficiency", sharey="col")
    with style():
        for at, ax in axes:
            for k, (name, label) in enumerate((("mie", "Mie"), ("rayleigh", "Rayleigh"))):
                ax.semilogy(at["wavelength"], at[name].to_numpy(), color=colour(k), ls=DASHES[k], label=label)
        _legend(figure, axes)
        return figure


def validity(data: xr.Dataset) -> Figure:
    """Rayleigh's efficiency over Mie's against the size parameter; bars show where the drawn spheres lie."""
    with style():
        figure = Figure(figsize=(7.4, 3.9))
        ax = figure.subplots()
        size = data["size"].to_numpy()
        limit = float(data.attrs["rayleigh_size_limit"])
        ax.axhspan(1 / 1.1, 1.1, color=MUTED, alpha=0.15, lw=0, label="within 10 %")
        ax.axvline(limit, color=INK, lw=1, ls=(0, (2, 2)))
        ax.text(limit * 0.94, 400.0, "r = λ/10", ha="right", color=INK, fontsize=9)
        particles = _names(data)
        for k, particle in enumerate(particles):
            at = data.sel(particle=particle)
            ax.loglog(size, at["ratio"].to_numpy(), color=colour(k), ls=DASHES[k % len(DASHES)], label=particle)
            for radius in data["radius"].to_numpy():
                x = at["size_parameter"].sel(radius=radius).to_numpy()
                y = 0.42 * 0.72**k
                ax.plot([x.min(), x.max()], [y, y], color=colour(k), lw=4, solid_capstyle="butt")
                if k == 0:
                    ax.text(
                        np.sqrt(x.min() * x.max()), y * 1.22, f"r {radius:g} µm", ha="center", color=INK, fontsize=9
                    )
        ax.set_xlim(size[0], size[-1])
        ax.set_ylim(0.2, 1e3)
        ax.set_xlabel("size parameter 2π r n/λ")
        ax.set_ylabel("efficiency: Rayleigh / Mie")
        ax.legend(loc="upper left")
        return figure


def absorption(data: xr.Dataset) -> Figure:
    """Absorption coefficient of every chromophore in 1/cm, logarithmic."""
    with style():
        figure = Figure(figsize=(7.4, 4.6))
        ax = figure.subplots()
        x = data["wavelength"].to_numpy()
        for k, name in enumerate(str(c) for c in data["chromophore"].values):
            y = data["absorption"].sel(chromophore=name).to_numpy()
            ax.semilogy(x, y, color=colour(k), ls=DASHES[k % len(DASHES)], label=name)
        ax.set_xlim(x[0], x[-1])
        ax.set_xlabel("wavelength [nm]")
        ax.set_ylabel("absorption coefficient [1/cm]")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5)
        return figure


def _names(data: xr.Dataset) -> list[str]:
    return [str(p) for p in data["particle"].values]


def _grid(
    data: xr.Dataset, x: str, y: str, sharey: Literal["none", "col"] = "none"
) -> tuple[Figure, list[tuple[xr.Dataset, Axes]]]:
    """One panel a particle (row) and radius (column)."""
    particles, radii = _names(data), data["radius"].to_numpy()
    with style():
        figure = Figure(figsize=(7.4, 0.7 + 2.3 * len(particles)))
        axes = figure.subplots(len(particles), len(radii), sharex=True, sharey=sharey, squeeze=False)
        for i, particle in enumerate(particles):
            for j, radius in enumerate(radii):
                axes[i, j].set_title(f"{particle}, r = {radius:g} µm")
                if i == len(particles) - 1:
                    axes[i, j].set_xlabel(x)
            axes[i, 0].set_ylabel(y)
    return figure, [
        (data.sel(particle=p, radius=r), axes[i, j]) for i, p in enumerate(particles) for j, r in enumerate(radii)
    ]


def _legend(figure: Figure, axes: list[tuple[xr.Dataset, Axes]]) -> None:
    figure.legend(*axes[0][1].get_legend_handles_labels(), loc="outside upper center", ncols=2)
