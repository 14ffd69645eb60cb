"""Volume fractions of collagen and elastin from two-colour micrographs (Nunes 2019, eq. 6.4 and Table 6.1).

A channel above a threshold makes a binary mask; its share of the pixels in the region of interest is the area
fraction, which for a random section estimates the volume fraction (Delesse's principle). A pixel above both
thresholds counts in both, as in the thesis: the fractions may overlap, and the overlap is reported.

The error stated is the counting error: how far the share would move on another field of the same tissue. Pixels
are not independent draws, so it is taken from block averages, not from a binomial of the pixel count. What the
choice of threshold does is stated beside it, and is usually larger.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.micrographs.files import MicrographPage, read_pages
from livlab.errors import InputError
from livlab.units import FloatArray

ELEMENTS = ("elastin", "collagen")
COLOURS = {"red": 0, "green": 1, "blue": 2}
MIN_BLOCKS = 16


@dataclass(frozen=True)
class Roi:
    """A rectangle of pixels: left column, top row, width and height."""

    x: int
    y: int
    width: int
    height: int

    @classmethod
    def parse(cls, text: str) -> Roi:
        """From "x,y,w,h".

        >>> Roi.parse("10,20,300,200")
        Roi(x=10, y=20, width=300, height=200)
        """
        try:
            x, y, width, height = (int(part) for part in text.split(","))
        except ValueError as error:
            raise InputError.of("roi", text, "must be four whole numbers x,y,w,h", "Give --roi 0,0,512,512.") from error
        return cls(x, y, width, height)

    def slices(self, page: MicrographPage) -> tuple[slice, slice]:
        """Rows and columns of the page; refused where the rectangle leaves it."""
        height, width = page.channels.shape[:2]
        if self.width < 1 or self.height < 1 or self.x < 0 or self.y < 0:
            raise InputError.of("roi", self, "needs a corner ≥ 0 and a size ≥ 1", "Give x,y,w,h in pixels.")
        if self.x + self.width > width or self.y + self.height > height:
            raise InputError.of(
                "roi",
                f"{self.x},{self.y},{self.width},{self.height}",
                f"must lie inside {page.source}, which has {width}×{height} pixels",
                "Shrink or move it.",
            )
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)


@dataclass(frozen=True)
class Method:
    """How a page is turned into fractions.

    Attributes
    ----------
    channels
        Channel of each element: "red", "green", "blue", "magenta" (the lesser of red and blue: light that is
        magenta has both), or a channel's number for files whose channels have no colour.
    threshold
        A pixel counts if its value is above this many 255ths of the full scale (the thesis: 10), or "otsu"
        (Otsu 1979), which finds the threshold that best parts each page's histogram in two.
    roi
        Region of interest; the whole page if not given.
    full_scale
        Value of a full pixel where it is not the stored type's largest: 4095 for 12 bits kept in 16.
    """

    channels: dict[str, str] = field(default_factory=lambda: {"elastin": "green", "collagen": "magenta"})
    threshold: float | Literal["otsu"] = 10.0
    roi: Roi | None = None
    full_scale: float | None = None

    def __post_init__(self) -> None:
        if set(self.channels) != set(ELEMENTS):
            raise InputError.of("channels", self.channels, "must name elastin and collagen", "Give both.")
        if self.threshold != "otsu" and not 0.0 <= self.threshold < 255.0:
            raise InputError.of("threshold", self.threshold, "must lie within [0, 255), or be 'otsu'", "Give 10.")
        if self.full_scale is not None and not (math.isfinite(self.full_scale) and self.full_scale > 0):
            raise InputError.of("full_scale", self.full_scale, "must be above 0", "Give 4095 for 12 bits.")


@dataclass(frozen=True)
class Fraction:
    """Area fraction of one element on one page.

    Attributes
    ----------
    value, standard_error
        Share of the pixels above the threshold, and its counting error.
    threshold
        In 255ths of full scale.
    threshold_effect
        Half of what the share changes between 0.8 and 1.2 times the threshold.
    """

    value: float
    standard_error: float
    threshold: float
    threshold_effect: float


@dataclass(frozen=True)
class PageFractions:
    """What one page gave; `overlap` is the share of pixels counted in both."""

    source: str
    number: int
    elastin: Fraction
    collagen: Fraction
    overlap: float
    pixels: int
    shape: tuple[int, int]
    warnings: tuple[str, ...]


def measure_files(paths: Iterable[Path], method: Method) -> Iterator[PageFractions]:
    """Fractions of every page of every file, in order; errors as `read_pages` and `measure_page`."""
    for path in paths:
        shape: tuple[int, ...] | None = None
        for page in read_pages(path):
            if shape is not None and page.channels.shape != shape:
                raise InputError.of(
                    "image", f"{path.name}, page {page.number}", "all pages of a stack must have one size", "Crop it."
                )
            shape = page.channels.shape
            yield measure_page(page, method)


def measure_page(page: MicrographPage, method: Method) -> PageFractions:
    """Area fractions of collagen and elastin on one page (Nunes 2019, eq. 6.4).

    Raises
    ------
    InputError
        If the region of interest leaves the page or holds fewer than 16 pixels, a channel does not exist, the
        pixels exceed the given full scale, or Otsu's method meets a channel of one value only.
    """
    rows, columns = method.roi.slices(page) if method.roi else (slice(None), slice(None))
    channels = page.channels[rows, columns]
    valid = np.ones(channels.shape[:2], dtype=bool) if page.inside is None else page.inside[rows, columns]
    pixels = int(valid.sum())
    name = f"{page.source}, page {page.number}"
    if pixels < MIN_BLOCKS:
        raise InputError.of(name, f"{pixels} pixels", f"the region needs at least {MIN_BLOCKS} that count", "Widen it.")
    full_scale = method.full_scale or page.full_scale
    if float(channels.max()) > full_scale:
        raise InputError.of(name, float(channels.max()), f"exceeds the full scale {full_scale:g}", "Mend full_scale.")
    notes = list(page.notes)
    if method.full_scale is None and page.full_scale == 65535 and 255 < int(page.channels.max()) <= 4095:
        notes.append("no value above 4095: if these are 12 bits in 16, give the full scale 4095")
    masks, found = {}, {}
    for element in ELEMENTS:
        values = _channel(page, channels, method.channels[element])
        masks[element], found[element], more = _element(element, values, valid, full_scale, method.threshold, name)
        notes += more
    overlap = float((masks["elastin"] & masks["collagen"]).sum() / pixels)
    notes += _crosstalk(found, overlap)
    return PageFractions(
        page.source, page.number, found["elastin"], found["collagen"], overlap, pixels, page.channels.shape[:2],
        tuple(notes),
    )  # fmt: skip


def counting_error(mask: NDArray[np.bool_], valid: NDArray[np.bool_]) -> tuple[float, bool]:
    """Standard error of a mask's share by block averages, and whether it has settled.

    The blocks double in edge; the scatter of their shares gives a standard error each time, which grows until
    a block is larger than the structures and then stays (Flyvbjerg & Petersen 1989, in two dimensions). The
    largest is taken, over sizes that leave at least 16 blocks. Blocks of unequal count enter as a ratio
    estimate (Cochran 1977, eq. 6.13). Never below what one pixel more or less would change.

    Parameters
    ----------
    mask, valid
        (H, W): pixels above the threshold; pixels that count.

    Returns
    -------
    tuple[float, bool]
        Standard error, and False where it still grew by more than 30 % at the last doubling: the structures
        are then not small against the region, and the error is a lower bound.
    """
    hits, counts = (mask & valid).astype(np.float64), valid.astype(np.float64)
    total = float(counts.sum())
    share = float(hits.sum()) / total
    smoothed = (share * total + 1.0) / (total + 2.0)
    errors = [math.sqrt(smoothed * (1.0 - smoothed) / total)]
    while True:
        hits, counts = _pooled(hits), _pooled(counts)
        blocks = int(np.count_nonzero(counts))
        if blocks < MIN_BLOCKS or hits.size == 1:
            break
        scatter = float(np.sum(np.square(hits - share * counts)))
        errors.append(math.sqrt(scatter * blocks / (blocks - 1)) / float(counts.sum()))
    settled = len(errors) >= 3 and (errors[-1] <= 1.3 * errors[-2] or share in (0.0, 1.0))
    return max(errors), settled


@dataclass(frozen=True)
class LayerTable:
    """Fractions by depth, in Table 6.1's form: shares of the layer's thickness counted from the surface.

    Attributes
    ----------
    edges
        (L + 1,) shares of the thickness, from 0 to 1.
    elastin, collagen
        (L,) volume fractions; `elastin_error` and `collagen_error` their counting errors.
    """

    edges: FloatArray
    elastin: FloatArray
    elastin_error: FloatArray
    collagen: FloatArray
    collagen_error: FloatArray


def layer_table(
    pages: list[PageFractions],
    *,
    depths_um: list[float] | None = None,
    thickness_um: float | None = None,
    edges: list[float] | None = None,
) -> LayerTable:
    """Bring pages into Table 6.1's form.

    With `edges` alone each page stands for one sublayer, as in the thesis. With `depths_um` each page lies at
    a depth: the fraction is linear between pages and constant beyond the outermost, and a sublayer gets its
    mean over its thickness; without `edges` the sublayers part half-way between pages. Errors follow exactly,
    for the means are linear in the pages. A single page without either fills the whole thickness.

    Parameters
    ----------
    pages
        As measured, in order of depth.
    depths_um
        Depth of each page in µm below the surface.
    thickness_um
        Thickness of the layer in µm; the deepest page if not given.
    edges
        Shares of the thickness, rising from 0 to 1.

    Raises
    ------
    InputError
        If numbers do not match, depths do not rise within 0 … thickness, the pages differ in size, or several
        pages have neither depths nor edges.
    """
    if not pages:
        raise InputError.of("pages", 0, "at least one is needed", "Give an image.")
    values = np.array([[p.elastin.value, p.collagen.value] for p in pages])
    errors = np.array([[p.elastin.standard_error, p.collagen.standard_error] for p in pages])
    if depths_um is None:
        bounds = np.array([0.0, 1.0] if edges is None and len(pages) == 1 else edges or [], dtype=np.float64)
        if len(bounds) == 0:
            raise InputError.of(
                "depths", None, f"{len(pages)} pages need depths or sublayers", "Give --stack depths, or --layers."
            )
        if len(bounds) != len(pages) + 1:
            raise InputError.of(
                "layers", edges, f"must be {len(pages) + 1} shares for {len(pages)} pages", "Or give --stack depths."
            )
        matrix = np.eye(len(pages))
    else:
        if len({p.shape for p in pages}) > 1:
            raise InputError.of(
                "stack", sorted({p.shape for p in pages}), "all pages of a stack must have one size", "Crop them."
            )
        depths = np.asarray(depths_um, dtype=np.float64)
        thickness = float(depths[-1] if thickness_um is None else thickness_um) if len(depths) else 0.0
        if len(depths) != len(pages) or not np.isfinite(depths).all() or (np.diff(depths) <= 0).any():
            raise InputError.of("stack", depths_um, f"must be {len(pages)} rising depths, one a page", "Mend them.")
        if not (thickness > 0 and depths[0] >= 0 and depths[-1] <= thickness and math.isfinite(thickness)):
            raise InputError.of(
                "stack", depths_um, f"must lie within 0 … {thickness:g} µm, the thickness", "Give --thickness-um."
            )
        middles = (depths[1:] + depths[:-1]) / 2 / thickness
        bounds = np.concatenate([[0.0], middles, [1.0]]) if edges is None else np.asarray(edges, dtype=np.float64)
        matrix = mean_matrix(depths / thickness, bounds)
    if bounds[0] != 0.0 or abs(bounds[-1] - 1.0) > 1e-9 or not (np.diff(bounds) > 0).all():
        raise InputError.of("layers", list(bounds), "must rise from 0 to 1 (0 to 100 %)", "Mend the edges.")
    mean, error = matrix @ values, np.sqrt(np.square(matrix) @ np.square(errors))
    return LayerTable(bounds, mean[:, 0], error[:, 0], mean[:, 1], error[:, 1])


def mean_matrix(depths: FloatArray, edges: FloatArray) -> FloatArray:
    """(L, P) weights of P pages in the mean over each of L intervals of the line drawn through them.

    >>> mean_matrix(np.array([0.0, 1.0]), np.array([0.0, 0.5, 1.0]))
    array([[0.75, 0.25],
           [0.25, 0.75]])
    """
    knots = np.unique(np.concatenate([depths, edges]))
    hats = np.stack([np.interp(knots, depths, row) for row in np.eye(len(depths))], axis=1)
    steps = np.diff(knots)[:, None]
    integral = np.concatenate([np.zeros((1, len(depths))), np.cumsum(steps * (hats[1:] + hats[:-1]) / 2, axis=0)])
    at_edges = integral[np.searchsorted(knots, edges)]
    return np.asarray(np.diff(at_edges, axis=0) / np.diff(edges)[:, None], dtype=np.float64)


def _channel(page: MicrographPage, channels: NDArray[Any], wanted: str) -> NDArray[Any]:
    if wanted.isdecimal():
        if int(wanted) < channels.shape[2]:
            return np.asarray(channels[..., int(wanted)])
    elif page.is_rgb and wanted == "magenta":
        return np.asarray(np.minimum(channels[..., 0], channels[..., 2]))
    elif page.is_rgb and wanted in COLOURS:
        return np.asarray(channels[..., COLOURS[wanted]])
    names = "red, green, blue, magenta or " if page.is_rgb else ""
    raise InputError.of(
        "channel", wanted, f"{page.source} has {names}0 … {channels.shape[2] - 1}", "Give --channel collagen=0, say."
    )


def _element(
    element: str,
    values: NDArray[Any],
    valid: NDArray[np.bool_],
    full_scale: float,
    threshold: float | Literal["otsu"],
    name: str,
) -> tuple[NDArray[np.bool_], Fraction, list[str]]:
    seen = values[valid]
    notes = []
    if threshold == "otsu":
        if seen.min() == seen.max():
            raise InputError.of(
                f"{name}: {element}", float(seen[0]), "Otsu's method needs two values", "Use a fixed threshold."
            )
        from skimage.filters import threshold_otsu

        raw = float(threshold_otsu(seen))
        above = seen > raw
        share = float(above.mean())
        between = share * (1 - share) * (float(seen[above].mean()) - float(seen[~above].mean())) ** 2
        # Otsu halves a single normal hump too, and then explains 2/π of its variance.
        if between < 0.7 * float(seen.var(dtype=np.float64)):
            notes.append(f"{element}: the histogram shows no second class; Otsu's threshold may split noise")
    else:
        raw = threshold * full_scale / 255.0
    mask = (values > raw) & valid
    error, settled = counting_error(mask, valid)
    share, low, high = (float(np.mean(seen > k * raw)) for k in (1.0, 0.8, 1.2))
    if not settled:
        notes.append(f"{element}: structures are not small against the region: its error is a lower bound")
    clipped = float(np.mean(seen >= full_scale))
    if clipped > 0.01:
        notes.append(f"{element}: {clipped:.1%} of the pixels are saturated: their glow may widen the structures")
    if threshold != "otsu" and share > 0.5 and float(np.median(seen)) < 2 * raw + full_scale / 255:
        notes.append(f"{element}: {share:.0%} lie just above the threshold: it may lie below the background")
    return mask, Fraction(share, error, raw * 255.0 / full_scale, (low - high) / 2), notes


def _crosstalk(found: dict[str, Fraction], overlap: float) -> list[str]:
    lesser = min(found, key=lambda element: found[element].value)
    other = next(element for element in ELEMENTS if element != lesser)
    small, large = found[lesser].value, found[other].value
    if small == 0.0 or overlap < 0.5 * small or overlap < 1.5 * small * large:
        return []
    return [f"{overlap / small:.0%} of the {lesser} pixels count as {other} too: the channels may leak into each other"]


def _pooled(blocks: FloatArray) -> FloatArray:
    for axis in (0, 1):
        n = blocks.shape[axis]
        if n >= 4:
            even, odd = (blocks[(slice(None),) * axis + (slice(k, n - n % 2, 2),)] for k in (0, 1))
            blocks = even + odd
        elif n > 1:
            blocks = blocks.sum(axis=axis, keepdims=True)
    return blocks
