"""The CSV tables of a picture run: columns, and rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from livlab.kinds.picture.claims import Key, PictureSummary
from livlab.kinds.picture.colour import ColourRoute, coordinate
from livlab.kinds.picture.film import CameraFilm
from livlab.kinds.shared.tissue_tables import Made, Rows
from livlab.model.colour import delta_e_2000, encode_srgb
from livlab.model.tissue.stack import REDIRECT_MEAN, OpticalStack, PlaneLayer

COLOURS = (
    "tissue", "reading", "route", "R", "G", "B", "R_se", "G_se", "B_se", "sRGB", "L", "L_se", "a", "a_se", "b", "b_se",
    "chroma", "hue", "hue_se",
)  # fmt: skip
COSTS = (
    "stage", "tissue", "reading", "seconds", "compile_seconds", "setup_seconds", "spp", "samples", "samples_per_second",
    "wavelengths", "relative_error", "memory_gib",
)  # fmt: skip


def srgb_hex(rgb: np.ndarray) -> str:
    """A linear sRGB colour as a screen takes it.

    >>> srgb_hex(np.array([1.0, 0.0, 0.21586]))
    '#ff0080'
    """
    coded = np.rint(255 * encode_srgb(np.clip(np.asarray(rgb, dtype=np.float64), 0.0, 1.0))).astype(int)
    return "#" + "".join(f"{c:02x}" for c in coded)


def colours(pictures: Mapping[Key, PictureSummary]) -> Made:
    """Mean colour of the lit body: linear sRGB as the picture shows it, sRGB, CIELAB."""
    rows: Rows = []
    for (tissue, reading), seen in pictures.items():
        for route, colour in seen.colours.items():
            row: dict[str, object] = {
                "tissue": tissue,
                "reading": reading,
                "route": route,
                "sRGB": srgb_hex(colour.rgb),
            }
            for k, channel in enumerate("RGB"):
                row[channel], row[f"{channel}_se"] = float(colour.rgb[k]), float(colour.rgb_se[k])
            for what in ("L", "a", "b", "hue"):
                row[what], row[f"{what}_se"] = colour.uncertain(what)
            row["chroma"] = coordinate(colour.lab, "chroma")
            rows.append(row)
    return COLOURS, rows


def colour_differences(
    films: Mapping[Key, CameraFilm],
    lit: np.ndarray,
    routes: Mapping[str, ColourRoute],
    exposure: float,
) -> Made:
    """CIEDE2000 between the colour routes of each picture: of the mean colour, and pixel by pixel over the lit body."""
    rows: Rows = []
    for (tissue, reading), film in films.items():
        pixels = xr.DataArray(film.radiance[lit], dims=("pixel", "wavelength"))
        made = {name: route.rgb(pixels, exposure) for name, route in routes.items()}
        names = list(made)
        for i, first in enumerate(names):
            for second in names[i + 1 :]:
                each = delta_e_2000(made[first], made[second])
                mean = delta_e_2000(made[first].mean("pixel"), made[second].mean("pixel"))
                rows.append(
                    {
                        "tissue": tissue,
                        "reading": reading,
                        "route": first,
                        "against": second,
                        "mean_colour": float(mean),
                        "median_pixel": float(each.median()),
                        "p95_pixel": float(each.quantile(0.95)),
                    }
                )
    return ("tissue", "reading", "route", "against", "mean_colour", "median_pixel", "p95_pixel"), rows


def convergence(films: Mapping[Key, CameraFilm]) -> Made:
    """How each picture's error fell: pixel median of the relative standard error after each pass."""
    columns = ("tissue", "reading", "seconds", "samples", "error")
    rows: Rows = [
        dict(zip(columns, (tissue, reading, *step), strict=True))
        for (tissue, reading), film in films.items()
        for step in film.trace
        if np.isfinite(step[2])
    ]
    return columns, rows


def absorption(stacks: Mapping[Key, OpticalStack]) -> Made:
    """Absorption of the last layer (the parenchyma) by its elements and in sum, as the thesis's Fig. 7.9 draws it."""
    rows: Rows = []
    for (tissue, reading), stack in stacks.items():
        layer = stack.layers[-1]
        parts = {i.name: i.rate * (1.0 - i.albedo) for i in layer.interactions}
        for k, x in enumerate(stack.wavelength_nm):
            about = {"tissue": tissue, "reading": reading, "layer": layer.name, "wavelength_nm": float(x)}
            total = 0.0
            for name, values in parts.items():
                total += float(values[k])
                if float(np.max(values)) > 0:
                    rows.append({**about, "element": name, "absorption_per_mm": float(values[k])})
            rows.append({**about, "element": "all", "absorption_per_mm": total})
    return ("tissue", "reading", "layer", "element", "wavelength_nm", "absorption_per_mm"), rows


def optics(stacks: Mapping[Key, OpticalStack], wavelength_nm: Sequence[float]) -> Made:
    """What colour comes from: absorption and reduced scattering of the last layer at some wavelengths.

    Scattering counts (1 − g) of each element; `kept_by_redirection` is the mean factor that Algorithm 2 leaves.
    A free path that Algorithm 1 absorbs (shorter than a cell) counts as absorption. `depth_above` is the reduced
    scattering of the layers above times their thickness: a haze over the last one, if its own colour is dark.
    """
    rows: Rows = []
    for (tissue, reading), stack in stacks.items():
        for x in wavelength_nm:
            k = int(np.abs(stack.wavelength_nm - x).argmin())
            absorbed, scattered, kept = _coefficients(stack.layers[-1], k)
            above = sum(_coefficients(layer, k)[1] * layer.thickness_mm for layer in stack.layers[:-1])
            rows.append(
                {
                    "tissue": tissue,
                    "reading": reading,
                    "wavelength_nm": float(stack.wavelength_nm[k]),
                    "absorption_per_mm": absorbed,
                    "reduced_scattering_per_mm": scattered,
                    "reduced_albedo": scattered / (absorbed + scattered) if absorbed + scattered > 0 else None,
                    "kept_by_redirection": kept,
                    "depth_above": above if len(stack.layers) > 1 else None,
                }
            )
    columns = (
        "tissue", "reading", "wavelength_nm", "absorption_per_mm", "reduced_scattering_per_mm", "reduced_albedo",
        "kept_by_redirection", "depth_above",
    )  # fmt: skip
    return columns, rows


def _coefficients(layer: PlaneLayer, k: int) -> tuple[float, float, float | None]:
    """Absorption and reduced scattering in 1/mm, and what a redirection keeps on average; at one wavelength."""
    total = sum(float(i.rate[k]) for i in layer.interactions)
    absorbed = scattered = met = kept = 0.0
    for i in layer.interactions:
        short = -np.expm1(-total * i.absorb_below_mm)
        survives = float(i.albedo[k] * (1.0 - short))
        redirected = float(i.rate[k]) * survives
        absorbed += float(i.rate[k]) * (1.0 - survives)
        if redirected > 0:
            scattered += redirected * (1.0 - i.phases[k].anisotropy)
            met += redirected
            kept += redirected * REDIRECT_MEAN[i.redirect]
    return absorbed, scattered, kept / met if met > 0 else None
