"""How far a colour may be off because a spectrum was known at too few wavelengths, or not far enough.

Two things are unknown: what lies beyond the first and last wavelength, and what lies between. The first is bounded by
how steep reflectance can be, weighed with what each of x̄, ȳ and z̄ sees there; the second is estimated by leaving out
every other wavelength and by interpolating linearly, and is not taken for less than known spectra err at that step.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from livlab.errors import RangeError
from livlab.metrics import ciede2000
from livlab.model.colour.primaries import lab
from livlab.model.colour.sight import Sight, interpolator
from livlab.units import FloatArray

JUST_NOTICEABLE = 1.0
"""ΔE00 above which a possible error is told."""

UNSEEN = 1e-2
"""Share of white's luminance beyond an image's wavelengths above which the route refuses."""

UNSEEN_OF_ANY = 0.5
"""The same of x̄ and z̄: with less than half of one of them seen, what comes out is no colour."""

WIDEST_NM = 60.0
"""Gap between wavelengths, from 400 to 700 nm, above which the route refuses."""

STEEPEST = 0.015
"""Change of reflectance a nm that must be reckoned with beyond the wavelengths; more if the spectrum itself is steeper.
Blood's edge at 600 nm has 0.01."""

OF_LINES, OF_HALF = 0.7, 0.5
"""What share of the difference between a spline and lines, or a spline through half the wavelengths, may be its error:
a spline whose step is halved errs at least four times less, unless features are as narrow as the step."""

AT_20_NM = 0.5
"""ΔE00 that spectra of tissue and paint err at a step of 20 nm, at most about; it grows with the square of the step,
and with the illuminant's ripple."""

RIPPLE = 4.0
"""By how much: under the lines of FL11 (ripple 0.39) colours at 20 nm err 2.5 times as much as under daylight."""


def check_seen(grid: FloatArray, sight: Sight, illuminant: str) -> None:
    """Refuse wavelengths that tell no colour, whatever the spectrum.

    Raises
    ------
    RangeError
        More than `UNSEEN` of luminance or `UNSEEN_OF_ANY` of X or Z beyond them, or a gap wider than `WIDEST_NM`.
    """
    band, (below, above) = f"{grid[0]:g}–{grid[-1]:g} nm", sight.unseen(grid)
    unseen = below + above
    remedy = "Render 400–700 nm or more."
    if unseen[1] > UNSEEN:
        raise RangeError.of(
            "wavelength",
            band,
            f"leaves out {100 * unseen[1]:.1f} % of white's luminance under {illuminant}, more than {100 * UNSEEN:g} %",
            remedy,
        )
    k = int(np.argmax(unseen))
    if unseen[k] > UNSEEN_OF_ANY:
        raise RangeError.of(
            "wavelength",
            band,
            f"leaves out {100 * unseen[k]:.0f} % of white's {'XYZ'[k]} under {illuminant}, more than "
            f"{100 * UNSEEN_OF_ANY:g} %",
            remedy,
        )
    gap, at = widest_gap(grid)
    if gap > WIDEST_NM:
        raise RangeError.of(
            "wavelength",
            f"{at:g} and {at + gap:g} nm",
            f"are {gap:g} nm apart, more than the {WIDEST_NM:g} nm between which a colour can be guessed",
            "Take wavelengths 20 nm apart, or 10.",
        )


def widest_gap(grid: FloatArray) -> tuple[float, float]:
    """Widest gap that reaches into 400–700 nm, and where it begins."""
    steps = np.where((grid[:-1] < 700.0) & (grid[1:] > 400.0), np.diff(grid), 0.0)
    if not steps.size:
        return float("inf"), float(grid[0])
    k = int(np.argmax(steps))
    return float(steps[k]), float(grid[k])


def possible_error(grid: FloatArray, spectra: FloatArray, sight: Sight, to_rgb: FloatArray) -> FloatArray:
    """(N,) ΔE00 by which the colours of (N, W) spectra may be off.

    Parameters
    ----------
    to_rgb
        (3, 3) from Σ over `sight.seen` to linear sRGB.
    """

    def colours(values: FloatArray) -> FloatArray:
        return lab(values @ sight.seen.T @ to_rgb.T)

    fine = sight.fine
    held = spectra @ interpolator(grid, fine, "cubic").T
    best = colours(held)
    beyond = np.zeros(len(spectra))
    for low, high in product((-1.0, 1.0), repeat=2):
        beyond = np.maximum(beyond, ciede2000(colours(_extended(grid, fine, held, spectra, (low, high))), best))
    between = np.full(len(spectra), AT_20_NM * (1.0 + RIPPLE * sight.ripple) * (widest_gap(grid)[0] / 20.0) ** 2)
    for share, made in _coarser(grid, spectra, fine):
        between = np.maximum(between, share * ciede2000(colours(made), best))
    return np.asarray(beyond + between)


def _coarser(grid: FloatArray, spectra: FloatArray, fine: FloatArray) -> list[tuple[float, FloatArray]]:
    """The spectra at 1 nm by lines, and by splines through every other wavelength, the ends kept, with their shares."""
    made = [(OF_LINES, spectra @ interpolator(grid, fine, "linear").T)]
    for first in (1, 2):
        keep = np.unique([0, *range(first, len(grid) - 1, 2), len(grid) - 1])
        if len(keep) < len(grid):
            made.append((OF_HALF, spectra[:, keep] @ interpolator(grid[keep], fine, "cubic").T))
    return made


def _extended(
    grid: FloatArray, fine: FloatArray, held: FloatArray, spectra: FloatArray, towards: tuple[float, float]
) -> FloatArray:
    """The spectra with their ends not held, but as steep as can be, up or down, within 0 and white."""
    slopes = np.abs(np.diff(spectra, axis=1)) / np.diff(grid)
    steep = np.maximum(STEEPEST, slopes.max(axis=1, initial=0.0))[:, None]
    most = np.maximum(1.0, spectra.max(axis=1, initial=0.0))[:, None]
    made: Any = held.copy()
    for away, sign in zip((grid[0] - fine, fine - grid[-1]), towards, strict=True):
        out = away > 0
        moved = held[:, out] + sign * steep * away[out]
        made[:, out] = np.clip(moved, np.minimum(held[:, out], 0.0), most)
    return np.asarray(made)


def told(error: float, grid: FloatArray, sight: Sight) -> str | None:
    """What a reader must know of a colour that may be off by so much; None where nobody could see it."""
    if not error > JUST_NOTICEABLE:
        return None
    below, above = sight.unseen(grid)
    unseen, gap = below + above, widest_gap(grid)[0]
    k = int(np.argmax(unseen))
    return (
        f"{grid[0]:g}–{grid[-1]:g} nm, at most {gap:g} nm apart, leave the colour uncertain by up to ΔE00 {error:.1f} "
        f"(1 is just noticeable): {100 * unseen[k]:.1f} % of white's {'XYZ'[k]} lies beyond them. "
        "400–700 nm in steps of 10 nm would do."
    )
