"""Settings of a launch, and a stack's tables as the lanes of a kernel see them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from livlab.model.tissue.stack import REDIRECT_MEAN
from livlab.model.transport.device import Device
from livlab.model.transport.source import Source
from livlab.model.transport.walk_tables import FOCUS, REDIRECTS, Tables


@dataclass(frozen=True)
class Settings:
    """What a launch is asked to do.

    Attributes
    ----------
    source
        The light.
    half_width_mm
        Half the side of a square sample, None for an endless one.
    capture_weight
        expected: a photon below this weight survives by chance.
    max_steps
        A photon is given up after so many steps.
    space
        Whether positions are followed (sides, beams, radii).
    """

    source: Source
    half_width_mm: float | None
    capture_weight: float
    max_steps: int
    space: bool


class Columns:
    """A stack's tables as the lanes see them: one value a lane, for its wavelength."""

    def __init__(self, d: Device, t: Tables, settings: Settings, per_wavelength: int) -> None:
        dr = d.dr
        self.d, self.t = d, t
        self.lanes, self.per_wavelength = per_wavelength * t.index.shape[1], per_wavelength
        lane = dr.arange(d.UInt32, self.lanes)
        self.wavelength = lane // dr.opaque(d.UInt32, per_wavelength)
        self.rank = lane % dr.opaque(d.UInt32, per_wavelength)
        self.thickness = [self.one(x) for x in t.thickness]
        self.above = [self.one(x) for x in np.roll(t.thickness, 1)]
        ratio, contrast = {}, {}
        for name, shift in (("up", 0), ("down", 2)):
            eta = t.index[1:-1] / t.index[shift : shift + t.shape.layers]
            ratio[name] = [self.each(x) for x in eta]
            contrast[name] = [self.each((1.0 - x) * (1.0 + x)) for x in eta]
        self.eta, self.contrast = ratio, contrast
        self.mfp = [[self.each(x) for x in layer] for layer in t.mfp]
        first = (slice(None), 0)
        self.survive = [self.each(x) for x in t.survive[first]]
        self.below = [self.one(x) for x in t.below[first]]
        self.kind = [self.each(x, d.UInt32) for x in t.kind[first]]
        self.g = [self.each(x) for x in t.g[first]]
        self.offset = [self.each(x, d.UInt32) for x in t.offset[first]]
        means = REDIRECT_MEAN if not settings.space else FOCUS
        self.focus = [self.one(abs(means[REDIRECTS[k]])) for k in t.redirect[first]]
        self.redirect = [self.one(k, d.UInt32) for k in t.redirect[first]]
        self.table = d.load(d.Float, t.table)
        self.rows, self.codes = self._packed(means)
        dr.make_opaque(self.wavelength, self.rank, self.table, self.rows, self.codes)

    def one(self, value: float, kind: Any = None) -> Any:
        """One number for all lanes, as data: another value uses the same kernel."""
        kind = kind or self.d.Float
        return self.d.dr.opaque(kind, int(value) if kind is self.d.UInt32 else float(value))

    def each(self, values: NDArray[Any], kind: Any = None) -> Any:
        """(W,) numbers spread over the lanes by wavelength."""
        kind = kind or self.d.Float
        return self.d.dr.gather(kind, self.d.load(kind, values), self.wavelength)

    def _packed(self, means: Any) -> tuple[Any, Any]:
        """Rows (survive, below, g, focus) and codes (kind, redirect, offset) by wavelength, layer and way."""
        t = self.t
        wide = t.survive.shape
        focus = np.abs([means[name] for name in REDIRECTS])[t.redirect]
        parts = [t.survive, np.broadcast_to(t.below[..., None], wide), t.g, np.broadcast_to(focus[..., None], wide)]
        rows = np.stack(parts, axis=-1).transpose(2, 0, 1, 3)
        codes = (t.kind | (t.redirect[..., None] << 2) | (t.offset << 4)).transpose(2, 0, 1)
        return self.d.load(self.d.Float, rows), self.d.load(self.d.UInt32, codes)
