"""The report's figures: each function returns a matplotlib figure made from what a run folder holds."""

from __future__ import annotations

import re
from importlib.resources import files
from io import StringIO
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text

from livlab.reports.tables import Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe & Ito's colours, told apart by the colour-blind; each also has its own marker and dash.
SERIES = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7b5ea7", "#8c6d31")
MARKERS = ("o", "s", "D", "^", "v", "P", "X", "*")
DASHES = ("-", (0, (5, 1.5)), (0, (7, 1.5, 1.5, 1.5)), (0, (1.5, 1.2)), "-", "-", "-", "-")
INK, MUTED, RULE = "#1b1f24", "#5b6470", "#e3e6ea"
_THEME = {INK: "var(--ink)", MUTED: "var(--muted)", RULE: "var(--rule)", "#8a919b": "var(--axis)"} | {
    colour: f"var(--series-{k})" for k, colour in enumerate(SERIES)
}


_MATH = re.compile(r"\$\\theta_[a-z]\$|^\$\\mathdefault\{[-−0-9.^{}\\times ]*\}\$$")
"""The house's own mathematics: angles, and powers of ten on logarithmic axes."""

_STYLED_OUT = re.compile(r"@import|url\((?!#)|<style[^<]*\\|style=(?:\"[^\"]*|'[^']*)\\")
"""A style that asks for something from elsewhere, or may hide that it does behind an escape."""

_DRAWS = frozenset({
    "svg", "g", "defs", "style", "path", "use", "clipPath", "rect", "circle", "line", "polyline", "polygon", "ellipse",
    "text", "tspan", "image", "linearGradient", "stop", "pattern", "title", "desc",
})  # fmt: skip


def style() -> Any:
    """Context in which every figure is drawn."""
    return mpl.rc_context(fname=str(files("livlab.reports") / "livlab.mplstyle"))


def colour(k: int) -> str:
    """Colour of the k-th series."""
    return SERIES[k % len(SERIES)]


def svg(figure: Figure) -> str:
    """Write a figure as SVG text, the same bytes for the same figure."""
    out = StringIO()
    _plain_dollars(figure)
    with style():
        # `savefig` would draw it twice, first for the layout alone, which drawing it does as well.
        FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None, "Creator": None})  # type: ignore[no-untyped-call]
    text = out.getvalue()
    return text[text.index("<svg") :]


def _plain_dollars(figure: Figure) -> None:
    """Keep a user's dollar signs from being read as mathematics, which fails where they are none."""
    for text in figure.findobj(Text):
        if "$" in _MATH.sub("", text.get_text()):
            text.set_parse_math(False)


def drawn_by_livlab(text: str) -> str | None:
    """The `<svg>` of a figure's file, if it holds nothing but drawing; None if a browser would do anything with it.

    A run folder may come from anywhere, and a page takes its figures in as they are: elements that draw, no events, no
    reference but to its own parts and to pictures within.
    """
    # HTML ends a comment earlier than XML does, and knows no sections; matplotlib says nothing that matters in either.
    plain = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>", "", text[max(text.find("<svg"), 0) :], flags=re.DOTALL)
    if "<!" in plain or "<?" in plain or _STYLED_OUT.search(plain):
        return None
    try:
        root = ElementTree.fromstring(plain)
    except ElementTree.ParseError:
        return None
    for part in root.iter():
        if part.tag.rsplit("}", 1)[-1] not in _DRAWS:
            return None
        for name, value in part.attrib.items():
            bare = name.rsplit("}", 1)[-1].lower()
            if bare.startswith("on") or (bare == "href" and not value.startswith(("#", "data:image/png;"))):
                return None
    return plain


def inline(text: str, name: str, label: str) -> str:
    """Make an SVG fit to stand inside a page: own ids, colours that follow the theme, a name for readers.

    Parameters
    ----------
    text
        The SVG.
    name
        Prefix that keeps the ids of several figures on one page apart.
    label
        What a screen reader says; escaped here.
    """
    from html import escape

    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'(xlink:href|href)="#([^"]+)"', rf'\1="#{name}-\2"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    for plain, themed in _THEME.items():
        text = re.sub(re.escape(plain) + r"\b", themed, text, flags=re.IGNORECASE)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    return text.replace("<svg ", f'<svg role="img" aria-label="{escape(label, quote=True)}" ', 1)


class Pictures:
    """Figures drawn once: plain for the folder, themed for the page."""

    def __init__(self) -> None:
        self.plain: dict[str, str] = {}

    def add(self, name: str, figure: Figure, caption: str) -> Picture:
        """Draw a figure under a name of its own; it also becomes figures/NAME.svg."""
        self.plain[name] = svg(figure)
        return Picture(Markup(inline(self.plain[name], name, caption)), caption)


def curves(result: xr.Dataset) -> Figure:
    """Processed curves of the readings (±2 SE) against the references (±1 SD), residuals beneath if there are any."""
    references = [str(r) for r in result["reference_name"].values] if "reference_name" in result else []
    with style():
        figure = Figure(figsize=(7.4, 5.6 if references else 4.0))
        if references:
            top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1.25])
        else:
            top = bottom = figure.subplots()
        x = result["wavelength_curve"].to_numpy()
        for k, name in enumerate(references):
            y = result["reference"].isel(reference_name=k).to_numpy()
            sd = result["reference_sd"].isel(reference_name=k).to_numpy()
            dash = "-" if k == 0 else (0, (2, 2))
            top.plot(x, y, color=INK, lw=2.2 if k == 0 else 1.2, ls=dash, label=name, zorder=5)
            if k == 0 and np.isfinite(sd).any():
                top.fill_between(x, y - sd, y + sd, color=MUTED, alpha=0.18, lw=0, label=f"{name}, ±1 SD")
        for k, reading in enumerate(str(r) for r in result["reading"].values):
            y = result["curve"].isel(reading=k).to_numpy()
            se = result["curve_se"].isel(reading=k).to_numpy()
            _band(top, x, y, se, k, reading)
            if references:
                base = result["reference"].isel(reference_name=0).to_numpy()
                bottom.plot(x, y - base, color=colour(k), ls=DASHES[k % len(DASHES)])
                bottom.fill_between(x, y - base - 2 * se, y - base + 2 * se, color=colour(k), alpha=0.2, lw=0)
        top.set_ylabel(_curve_label(result))
        top.set_ylim(bottom=min(0.0, top.get_ylim()[0]))
        # Above the axes: no corner of this plot is free of curves for every tissue.
        top.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        if references:
            bottom.axhline(0, color=INK, lw=1)
            bottom.set_ylabel("model − reference")
        bottom.set_xlabel("wavelength [nm]")
        return figure


def absolute(result: xr.Dataset) -> Figure:
    """Measured value of each reading at each simulated wavelength, with ±2 SE, not normalised."""
    with style():
        figure = Figure(figsize=(7.4, 3.6))
        ax = figure.subplots()
        x = result["wavelength"].to_numpy()
        for k, reading in enumerate(str(r) for r in result["reading"].values):
            y = result["reflectance"].isel(reading=k).to_numpy()
            se = result["reflectance_se"].isel(reading=k).to_numpy()
            ax.errorbar(
                x,
                y,
                2 * np.nan_to_num(se),
                color=colour(k),
                marker=MARKERS[k % len(MARKERS)],
                ls=DASHES[k % len(DASHES)],
                capsize=2,
                label=reading,
            )
        ax.set_ylim(bottom=0)
        ax.set_xlabel("wavelength [nm]")
        ax.set_ylabel(str(result["reflectance"].attrs.get("long_name", "reflectance")).replace(" (", "\n("))
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
        return figure


def coefficients(data: xr.Dataset) -> Figure:
    """Absorption and scattering of every element at every wavelength, one row a reading, in 1/cm."""
    readings = [str(r) for r in data["reading"].values]
    elements = [str(e) for e in data["element"].values]
    with style():
        figure = Figure(figsize=(7.4, 0.9 + 2.4 * len(readings)))
        axes = figure.subplots(len(readings), 2, sharex=True, sharey=False, squeeze=False)
        x = data["wavelength"].to_numpy()
        shown: dict[str, Any] = {}
        for row, reading in enumerate(readings):
            for column, quantity in enumerate(("absorption", "scattering")):
                ax = axes[row, column]
                # The largest over the layers: an element such as collagen stands in several sublayers.
                values = data[quantity].isel(reading=row).max("layer", skipna=True).to_numpy() * 10.0
                for k, element in enumerate(elements):
                    y = values[k]
                    if not np.isfinite(y).any() or not (np.nan_to_num(y) > 0).any():
                        continue
                    (line,) = ax.plot(x, np.where(y > 0, y, np.nan), color=colour(k), ls=DASHES[k % len(DASHES)])
                    if len(x) == 1:
                        line.set_marker(MARKERS[k % len(MARKERS)])
                    shown.setdefault(element, line)
                if ax.lines:
                    ax.set_yscale("log")
                ax.set_title(f"{reading}: {quantity}")
                ax.set_ylabel("1/cm")
                if row == len(readings) - 1:
                    ax.set_xlabel("wavelength [nm]")
        figure.legend(list(shown.values()), list(shown), loc="outside upper center", ncols=min(4, max(1, len(shown))))
        return figure


def budget(result: xr.Dataset) -> Figure:
    """Where the light went, stacked to 1 at every wavelength, one panel a reading."""
    readings = [str(r) for r in result["reading"].values]
    parts = budget_parts(result)
    with style():
        columns = min(3, len(readings))
        rows = -(-len(readings) // columns)
        figure = Figure(figsize=(7.4, 1.0 + 2.5 * rows))
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        x = result["wavelength"].to_numpy()
        width = 0.9 * (np.diff(x).min() if len(x) > 1 else 10.0)
        for k, reading in enumerate(readings):
            ax = axes.flat[k]
            base = np.zeros(len(x))
            for j, (label, values) in enumerate(parts):
                y = np.clip(np.nan_to_num(values[k]), 0, None)
                ax.bar(x, y, width, base, color=colour(j), label=label if k == 0 else None, lw=0)
                base = base + y
            ax.set_title(reading)
            ax.set_ylim(0, 1.02)
            ax.grid(False, axis="x")
        for ax in axes.flat[len(readings) :]:
            ax.set_visible(False)
        for ax in axes[-1]:
            ax.set_xlabel("wavelength [nm]")
        axes[0, 0].set_ylabel("share of the incident light")
        figure.legend(loc="outside upper center", ncols=4)
        return figure


def budget_parts(result: xr.Dataset) -> list[tuple[str, np.ndarray[Any, Any]]]:
    """Name and (reading, wavelength) values of each part of the energy budget that is not zero everywhere."""
    names = {
        "specular": "specular",
        "diffuse_reflectance": "diffusely reflected",
        "transmittance": "transmitted",
        "absorbed_total": "absorbed",
        "lost": "lost through the sides",
        "redirect_loss": "removed by Algorithm 2",
        "residual": "residual",
    }
    parts: list[tuple[str, np.ndarray[Any, Any]]] = []
    if "transmittance" in result and result["transmittance"].isnull().all():
        return parts  # the solver counted what is read, not the rest
    for key, label in names.items():
        if key == "absorbed_total" and "absorbed" in result:
            values = result["absorbed"].sum("layer").transpose("reading", "wavelength").to_numpy()
        elif key in result:
            values = result[key].transpose("reading", "wavelength").to_numpy()
        else:
            continue
        if np.nanmax(np.abs(values), initial=0.0) > 1e-9:
            parts.append((label, values))
    return parts


def _band(ax: Axes, x: Any, y: Any, se: Any, k: int, label: str) -> None:
    ax.plot(x, y, color=colour(k), ls=DASHES[k % len(DASHES)], label=label)
    if len(x) == 1:
        ax.plot(x, y, color=colour(k), marker=MARKERS[k % len(MARKERS)], ls="none")
    ax.fill_between(x, y - 2 * se, y + 2 * se, color=colour(k), alpha=0.25, lw=0)


def _curve_label(result: xr.Dataset) -> str:
    kind = str(result.attrs.get("normalisation", "none"))
    return {"max": "reflectance / its maximum", "sum": "reflectance / its sum"}.get(kind, "reflectance")
