"""Settings of a launch, and a stack's tables as the lanes of a kernel see them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from livlab.model.tissue.stack import REDIRECT_MEAN
from livlab.model.transport.device import Device
from livlab.model.transport.source import Source
from livlab.model.transport.walk.tables import FOCUS, REDIRECTS, Tables


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
        self.survive = self._ways(t.survive)
        self.loss = self._ways(t.loss)
        self.kind, self.g, self.offset = self._ways(t.kind, d.UInt32), self._ways(t.g), self._ways(t.offset, d.UInt32)
        means = FOCUS if settings.space else REDIRECT_MEAN
        focus = np.abs([means[name] for name in REDIRECTS])[t.redirect]
        self.below = [[self.one(x) for x in way] for way in t.below.T]
        self.focus = [[self.one(x) for x in way] for way in focus.T]
        self.redirect = [[self.one(x, d.UInt32) for x in way] for way in t.redirect.T]
        self.table = d.load(d.Float, t.table)
        dr.make_opaque(self.wavelength, self.rank, self.table)

    def one(self, value: float, kind: Any = None) -> Any:
        """One number for all lanes, as data: another value uses the same kernel."""
        kind = kind or self.d.Float
        return self.d.dr.opaque(kind, int(value) if kind is self.d.UInt32 else float(value))

    def each(self, values: NDArray[Any], kind: Any = None) -> Any:
        """(W,) numbers spread over the lanes by wavelength."""
        kind = kind or self.d.Float
        return self.d.dr.gather(kind, self.d.load(kind, values), self.wavelength)

    def _ways(self, values: NDArray[Any], kind: Any = None) -> list[list[Any]]:
        """(L, ways, W) numbers as a list over ways of lists over layers."""
        return [[self.each(x, kind) for x in way] for way in values.transpose(1, 0, 2)]
