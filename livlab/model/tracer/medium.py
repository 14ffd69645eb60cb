"""A tissue on the device: what a step looks up, and what a path weighs at each wavelength."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import numpy as np

from livlab.model.tracer.media import CELLS_PER_OCTAVE, FRESNEL_CELLS, NEVER, OCTAVES, Media
from livlab.model.tracer.state import Collision, Throughput
from livlab.model.transport.device import Device
from livlab.model.transport.walk.tables import HENYEY_GREENSTEIN, ISOTROPIC, RAYLEIGH, REDIRECTS

FOURPI = 12.566370614359172
_SHIFT = 23 - (CELLS_PER_OCTAVE.bit_length() - 1)
_BASE = (int(np.float32(2.0 ** (1 - OCTAVES)).view(np.uint32)) >> _SHIFT) - 1
_LAST = OCTAVES * CELLS_PER_OCTAVE

NONE = 0xFFFFFFFF
"""No row: the path has not hit the body's surface."""

HEAD = 5
"""Entries of a collision's row before its ways: albedo, free path of Algorithm 1, base of the table and of the short
one, loss."""


class Medium:
    """The arrays of a tissue, and what depends on nothing else.

    A collision's row holds, for a layer and a hero: its albedo and so on, then for each way of scattering its
    probability (cumulated), its code (−1 − kind for a closed form, else the offset of its table) and g.
    """

    def __init__(self, d: Device, mi: Any, m: Media) -> None:
        self.d, self.mi, self.m, self.dr = d, mi, m, d.dr
        self.several = m.wavelengths > 1
        self.ways = m.walk.shape.ways
        self.lossy = bool((m.loss > 0.0).any())
        self.short = bool((m.below > 0).any())
        self.focused = bool((m.focus != 1.0).any())
        self.tabled = not all(p or not s for p, s in zip(m.plain, m.scatters, strict=True))
        self.vector = self.several and (self.tabled or any(m.dispersive))
        self.first = self.several and m.dispersive[0]
        load = partial(d.load, mi.Float)
        one = partial(_opaque, d, mi)
        self.stride = max(4, 8 * -(-m.layers // 8)) if m.layers > 4 else 4
        self.rates = load(_padded(m.extinction.T, self.stride))
        self.collision_stride = 8 * -(-(HEAD + 3 * self.ways) // 8)
        self.collisions = load(self._collisions())
        self.rows = load(m.rows)
        self.reflectance = load(m.reflectance)
        both = np.stack([m.reflectance, 1.0 - m.reflectance], axis=3)
        self.log_fresnel = load(np.log(np.maximum(both, 1e-30)) if self.several and any(m.dispersive) else [0.0])
        self.index = load(m.index)
        with np.errstate(divide="ignore"):
            extinction = np.maximum(np.log(m.extinction), NEVER)
            scattered = np.maximum(np.log(m.scattering), NEVER)
        self.table = load(m.walk.table)
        self.focus = [one(x) for x in m.focus]
        self.log_extinction = load(_padded(extinction, m.padded))
        self.log_scattered = load(_padded(scattered, m.padded))
        self.loss = load(np.concatenate([_padded(m.loss, m.padded), np.zeros((1, m.padded))]))
        self.extinction_of = [[one(x) for x in layer] for layer in m.extinction]
        self.log_scattered_of = [[one(x) for x in layer] for layer in scattered]
        self.counted = [k for k in range(m.layers) if self.several and m.plain[k] and m.scatters[k]]
        self.top = [one(-1e30), *(one(x) for x in m.top[1:-1]), one(1e30)]
        self.region_top = [one(m.top[a]) for a, _ in m.regions]
        self.region_bottom = [one(m.top[b + 1]) for _, b in m.regions]
        self.inner = float(m.top[-2]) if m.layers > 1 else 0.0
        self.dr.make_opaque(
            [
                self.rates,
                self.collisions,
                self.rows,
                self.reflectance,
                self.log_fresnel,
                self.index,
                self.log_extinction,
                self.log_scattered,
                self.loss,
            ]
        )

    def _collisions(self) -> Any:
        m, w = self.m, self.m.walk
        out = np.zeros((m.layers, m.wavelengths, self.collision_stride))
        albedo = np.divide(m.scattering, m.extinction, out=np.zeros_like(m.scattering), where=m.extinction > 0)
        out[..., 0] = albedo
        out[..., 1] = m.below[:, None]
        out[..., 2] = m.base[:, None]
        out[..., 3] = m.base_short[:, None]
        out[..., 4] = m.loss > 0
        with np.errstate(invalid="ignore", divide="ignore"):
            cumulated = np.cumsum(w.survive, axis=1) / np.sum(w.survive, axis=1, keepdims=True)
        cumulated = np.nan_to_num(cumulated, nan=1.0)
        for c in range(self.ways):
            out[..., HEAD + 3 * c] = cumulated[:, c]
            closed = w.kind[:, c] <= HENYEY_GREENSTEIN
            out[..., HEAD + 3 * c + 1] = np.where(closed, -1 - w.kind[:, c], w.offset[:, c])
            out[..., HEAD + 3 * c + 2] = w.g[:, c]
        return out

    def packet(self, table: Any, row: Any, width: int, active: Any = True) -> Any:
        """Neighbouring numbers of a table, loaded together."""
        return packet(self.mi, self.dr, table, row, width, active)

    def pick(self, which: Any, values: Sequence[Any]) -> Any:
        """The value of each lane's own number."""
        dr = self.dr
        return reduce(lambda found, k: dr.select(which == k, values[k], found), range(1, len(values)), values[0])

    def cell(self, w: Any) -> Any:
        """Cell of a table of phase functions in which w = 1 − cos θ falls."""
        bits = self.dr.reinterpret_array(self.mi.UInt32, self.dr.maximum(w, 0.0)) >> _SHIFT
        return self.dr.clip(self.mi.Int32(bits) - _BASE, 0, _LAST)

    def log_phase(self, code: Any, g: Any, w: Any) -> Any:
        """Ln p(w) of a closed form."""
        dr, mi, kinds = self.dr, self.mi, self.m.walk.shape.kinds
        value = mi.Float(1.0 / FOURPI)
        if RAYLEIGH in kinds:
            value = dr.select(code == -1 - RAYLEIGH, 0.75 / FOURPI * (1.0 + dr.square(1.0 - w)), value)
        if HENYEY_GREENSTEIN in kinds:
            # 1 + g² − 2g cos θ = (1 − g)² + 2 g w keeps the forward peak's digits.
            root = dr.rsqrt(dr.square(1.0 - g) + 2.0 * g * w)
            peaked = (1.0 - g) * (1.0 + g) / FOURPI * root * root * root
            value = dr.select(code == -1 - HENYEY_GREENSTEIN, peaked, value)
        return dr.log(dr.maximum(value, 1e-30)) if kinds != (ISOTROPIC,) else mi.Float(float(np.log(1.0 / FOURPI)))

    def phase_function(self, collision: Collision, wavelength: Any, active: Any) -> Callable[[Any], Any]:
        """Phase function of what a collision is with, in 1/sr at w = 1 − cos θ, at the wavelength of a number."""
        dr, mi, m = self.dr, self.mi, self.m
        layer, base = collision.layer, collision.base

        def value(w: Any) -> Any:
            found = self.log_phase(collision.code, collision.g, w)
            if self.tabled:
                tabled = base >= 0.0
                rate = dr.gather(mi.Float, self.log_scattered, layer * m.padded + wavelength, active & tabled)
                at = (mi.UInt32(dr.maximum(base, 0.0)) + mi.UInt32(self.cell(w))) * m.padded + wavelength
                found = dr.select(tabled, dr.gather(mi.Float, self.rows, at, active & tabled) - rate, found)
            return dr.exp(found)

        return value

    def factor(self, layer: Any, u: Any) -> Any:
        """Algorithm 2's factor at an azimuth, 2πu."""
        dr, mi = self.dr, self.mi
        cosine = dr.cos(6.283185307179586 * u)
        made = {0: mi.Float(1.0), 1: dr.abs(cosine), 2: cosine, 3: dr.maximum(cosine, 0.0)}
        codes = [int(self.m.walk.redirect[k].max()) for k in range(self.m.layers)]
        assert all(c < len(REDIRECTS) for c in codes)
        return self.pick(layer, [made[c] for c in codes])

    def fresnel_row(self, interface: Any, below: Any, cosine: Any) -> Any:
        """Row of Fresnel's table: a region's upper interface, hit from below or above at a cosine."""
        dr, mi = self.dr, self.mi
        cell = dr.minimum(mi.UInt32(cosine * FRESNEL_CELLS), FRESNEL_CELLS - 1)
        return (2 * interface + dr.select(below, mi.UInt32(1), mi.UInt32(0))) * FRESNEL_CELLS + cell

    def weights(
        self, throughput: Throughput, *, lengths: Any, log_scatter: Sequence[Any], log_collide: Sequence[Any]
    ) -> list[Any]:
        """f_l / mean_h p_h of a path (the balance heuristic over heroes: Veach 1997, eq. 9.8), `common` left out.

        Parameters
        ----------
        lengths
            Lengths by layer that only f has; None: none.
        log_scatter
            Logarithm of what f has beside the path's own sums, a value a wavelength.
        log_collide
            Logarithm of what p has beside them, a value a wavelength.
        """
        dr, m = self.dr, self.m
        width = range(m.wavelengths)
        forced = [0.0] * m.padded
        if not isinstance(throughput.forced, tuple):
            forced = self.packet(self.loss, throughput.forced, m.padded)
        above = list(log_scatter)
        if self.first:
            known = throughput.first != NONE
            row = self.packet(self.log_fresnel, dr.select(known, throughput.first, 0), m.padded, known)
            above = [x + dr.select(known, r, 0.0) for x, r in zip(above, row, strict=False)]
        if lengths is not None:
            for k, path in enumerate(lengths):
                above = [x - self.extinction_of[k][w] * path for w, x in enumerate(above)]
        below = [forced[w] + log_collide[w] for w in width]
        if not self.several:
            return [dr.exp(above[0] - below[0])]
        shared = list(throughput.rows) if self.vector else [self.mi.Float(0.0) for _ in width]
        for k in range(m.layers):
            shared = [dr.fma(-self.extinction_of[k][w], throughput.lengths[k], shared[w]) for w in width]
        for n, k in zip(throughput.counts, self.counted, strict=True):
            shared = [dr.fma(self.log_scattered_of[k][w], n, shared[w]) for w in width]
        below = [x + y for x, y in zip(below, shared[: m.wavelengths], strict=True)]
        highest = reduce(dr.maximum, below)
        total = sum(dr.exp(x - highest) for x in below)
        scale = m.wavelengths * dr.rcp(total)
        return [dr.exp(dr.minimum(above[w] + shared[w] - highest, 60.0)) * scale for w in width]


def _opaque(d: Device, mi: Any, x: float) -> Any:
    return d.dr.opaque(mi.Float, float(x))


def _padded(values: Any, width: int) -> Any:
    out = np.zeros((values.shape[0], width))
    out[:, : values.shape[1]] = values
    return out


def packet(mi: Any, dr: Any, table: Any, row: Any, width: int, active: Any = True) -> list[Any]:
    """A row of a table, `width` numbers, loaded together."""
    if width == 1:
        return [dr.gather(mi.Float, table, row, active)]
    found = dr.gather(mi.ArrayXf, table, row, active, shape=(width, dr.width(row)))
    return [found[k] for k in range(width)]
