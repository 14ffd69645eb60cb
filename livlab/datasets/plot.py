"""A figure of a dataset; matplotlib is imported only when one is asked for."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from livlab.datasets.dataset import Dataset
from livlab.errors import EnvironmentProblem, InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("svg", "png", "pdf")
_LOG_ABOVE_RATIO = 100.0
_COLOURS = ("#0b4f8a", "#b3401c", "#3b7a3a", "#7a4f9a", "#5f5f5f", "#a07a00")


def plot(dataset: Dataset) -> Figure:
    """Draw every numeric column against the wavelength, standard deviations (``*_sd``) as bands.

    The ordinate is logarithmic where a positive curve spans more than two decades.

    Raises
    ------
    DatasetError
        If the table has no wavelengths.
    """
    from matplotlib.figure import Figure

    wavelength = dataset.wavelength_nm
    names = dataset.value_columns
    bands = {name.removesuffix("_sd"): name for name in names if name.endswith("_sd") and name[:-3] in names}
    curves = [name for name in names if name not in bands.values()]
    units = list(dict.fromkeys(dataset.unit(name) for name in curves))
    figure = Figure(figsize=(7.2, 1.4 + 2.9 * len(units)), layout="constrained")
    axes = figure.subplots(len(units), 1, sharex=True, squeeze=False)[:, 0]
    for panel, unit in zip(axes, units, strict=True):
        shown = [name for name in curves if dataset.unit(name) == unit]
        for name, colour in zip(shown, _COLOURS * (1 + len(shown) // len(_COLOURS)), strict=False):
            values = dataset.column(name)
            marker = "." if len(dataset) <= 150 else ""
            panel.plot(wavelength, values, color=colour, marker=marker, lw=1.3, ms=4, label=name.replace("_", " "))
            if name in bands:
                spread = dataset.column(bands[name])
                panel.fill_between(wavelength, values - spread, values + spread, color=colour, alpha=0.18, lw=0)
        lowest = min(float(dataset.column(name).min()) for name in shown)
        highest = max(float(dataset.column(name).max()) for name in shown)
        if lowest > 0 and highest / lowest > _LOG_ABOVE_RATIO:
            panel.set_yscale("log")
        panel.set_ylabel("ratio" if unit == "1" else unit)
        panel.grid(visible=True, which="major", color="#dddddd", lw=0.6)
        panel.spines[["top", "right"]].set_visible(False)
        panel.legend(frameon=False, fontsize=9)
    axes[-1].set_xlabel("wavelength, nm")
    axes[0].set_title(dataset.meta.title, fontsize=11, loc="left", wrap=True)
    doi = f"   doi:{dataset.meta.doi}" if dataset.meta.doi else ""
    figure.supxlabel(
        f"{dataset.name}, version {dataset.meta.version}   {dataset.meta.kind}{doi}", fontsize=8, color="#555555"
    )
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as SVG, PNG or PDF; the file appears whole or not at all.

    Raises
    ------
    InputError
        If the ending is none of these.
    EnvironmentProblem
        If it cannot be written.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise InputError.of("output", str(path), "must end in .svg, .png or .pdf", "Name it, for example, plot.svg.")
    work = ""
    try:
        handle, work = tempfile.mkstemp(prefix=".plot-", suffix=path.suffix, dir=path.parent)
        with os.fdopen(handle, "wb") as stream:
            figure.savefig(stream, format=kind, dpi=150)
        Path(work).chmod(0o644)
        Path(work).replace(path)
    except OSError as error:
        raise EnvironmentProblem(
            f"{path} cannot be written: {error.strerror or error}.", remedy="Choose another file with -o FILE."
        ) from error
    finally:
        if work:
            Path(work).unlink(missing_ok=True)
    return path
