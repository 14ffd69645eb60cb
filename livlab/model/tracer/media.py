"""From an optical stack to the arrays of the tracer: rates, phase functions and Fresnel's law at all wavelengths.

One path serves all wavelengths, so beside the numbers that its own ("hero") wavelength draws with, the density of
every draw is needed at all the others. Where it is the same but for a rate, path length and count of collisions tell
it; where phase functions differ, rows of a table hold ln Σ σ_s p(w) over w = 1 − cos θ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.stack import REDIRECT_MEAN, Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.fresnel import fresnel
from livlab.model.transport.walk.tables import Tables, tables
from livlab.units import FloatArray

CELLS_PER_OCTAVE = 64
OCTAVES = 25
"""Rows of a phase function from w = 2^−24 to 2: a cell is 1.1 % of w, half of that in the angle."""

FRESNEL_CELLS = 2048
"""Cells of the cosine, each with the mean reflectance over it."""

SAME = 1e-9
NEVER = -80.0
"""Logarithm of a density that is none: e^−80 squared is still a float."""


@dataclass(frozen=True)
class Media:
    """What the kernel reads of a tissue, lengths in units of the scene.

    Attributes
    ----------
    wavelengths, padded
        Number of wavelengths, and the length of a row in memory.
    top
        (L + 1,) depth of each layer's upper side, and of the last one's lower side.
    regions
        Layers between two changes of index: first and last layer of each.
    extinction, scattering
        (L, W) rates in 1/unit.
    index
        (R + 1, W) refractive index outside and in each region.
    loss
        (L, W) ln(extinction / scattering): what a forced survival must be weighed with.
    focus
        (L,) mean of Algorithm 2's factor.
    below
        (L,) free path that ends in absorption, 0 for none.
    plain
        (L,) whether the layer scatters one way that is the same at all wavelengths.
    base, base_short
        (L,) first row of the layer's table; the second for free paths shorter than `below`. −1: none.
    rows
        (N, padded) ln Σ σ_s p at each cell.
    reflectance
        (R, 2, FRESNEL_CELLS, padded) of region r's upper interface, hit from above and from below.
    refracts, dispersive
        (R,) whether the upper interface of a region changes the index at all; and whether it differs by wavelength.
    walk
        The walk's own tables: ways to scatter and inverse distributions.
    """

    wavelengths: int
    padded: int
    top: FloatArray
    regions: tuple[tuple[int, int], ...]
    extinction: FloatArray
    scattering: FloatArray
    index: FloatArray
    loss: FloatArray
    focus: FloatArray
    below: FloatArray
    plain: tuple[bool, ...]
    base: NDArray[np.int64]
    base_short: NDArray[np.int64]
    rows: NDArray[np.float32]
    reflectance: NDArray[np.float32]
    refracts: tuple[bool, ...]
    dispersive: tuple[bool, ...]
    walk: Tables

    @property
    def layers(self) -> int:
        """Number of layers."""
        return len(self.extinction)

    @property
    def scatters(self) -> tuple[bool, ...]:
        """Whether each layer scatters at all."""
        return tuple(bool(x.any()) for x in self.scattering)


def media(
    stack: OpticalStack, *, mm_per_unit: float = 1.0, room_mm: float = 0.0, split: bool = False, hollow: bool = False
) -> Media:
    """Lay a stack out for the tracer.

    Parameters
    ----------
    stack
        The tissue from its surface inwards.
    mm_per_unit
        Length of the scene's unit.
    room_mm
        Greatest depth there is; below a stack that ends before, the body is clear, of index `n_below`.
    hollow
        So it is in any case.
    split
        Every layer its own region, though the index may not change: where each interface is a mesh.

    Raises
    ------
    InputError
        Scatterers of one layer that differ in Algorithm 2's factor or in the free path of Algorithm 1.
    """
    layers = list(stack.layers)
    bottom = float(sum(x.thickness_mm for x in layers))
    if bottom < room_mm or hollow:
        layers.append(PlaneLayer("below", math.inf, stack.n_below))
    count = len(stack.wavelength_nm)
    padded = padded_width(count)
    walk = tables(OpticalStack(stack.wavelength_nm, tuple(layers), stack.n_above, stack.n_below), "expected")
    extinction = np.array([sum((i.rate for i in x.interactions), np.zeros(count)) for x in layers]) * mm_per_unit
    scattering = np.array([_scattering(x) for x in layers]) * mm_per_unit
    regions = _regions(layers, split)
    index = np.stack([stack.n_above, *(layers[a].n for a, _ in regions)])
    rows, base, short, plain = _rows(layers, padded, mm_per_unit)
    reflectance, refracts, dispersive = _reflectances(index, padded)
    with np.errstate(divide="ignore", invalid="ignore"):
        loss = np.where(scattering > 0, np.log(extinction / np.where(scattering > 0, scattering, 1.0)), 0.0)
    top = np.concatenate([[0.0], np.cumsum([x.thickness_mm for x in layers])]) / mm_per_unit
    return Media(
        wavelengths=count,
        padded=padded,
        top=np.minimum(top, 1e30),
        regions=regions,
        extinction=extinction,
        scattering=scattering,
        index=index,
        loss=loss,
        focus=np.array([_focus(x) for x in layers]),
        below=np.array([_below(x) for x in layers]) / mm_per_unit,
        plain=plain,
        base=base,
        base_short=short,
        rows=rows,
        reflectance=reflectance,
        refracts=refracts,
        dispersive=dispersive,
        walk=walk,
    )


def padded_width(count: int) -> int:
    """Length of a row that loads in packets of 1, 2, 4 or eights."""
    return next((n for n in (1, 2, 4) if count <= n), 8 * math.ceil(count / 8))


def _scatterers(layer: PlaneLayer) -> list[Interaction]:
    return [i for i in layer.interactions if (i.rate * i.albedo).any()]


def _scattering(layer: PlaneLayer) -> FloatArray:
    return sum((i.rate * i.albedo for i in _scatterers(layer)), np.zeros_like(layer.n))


def _focus(layer: PlaneLayer) -> float:
    """Mean of Algorithm 2's factor: the azimuth is counted from an axis drawn anew, so that no direction is special."""
    codes = {i.redirect for i in _scatterers(layer)}
    if len(codes) > 1:
        raise InputError.of(
            f"{layer.name}.redirect", sorted(codes), "must be one for all that scatters in a layer", "Use one factor."
        )
    return REDIRECT_MEAN[codes.pop()] if codes else 1.0


def _below(layer: PlaneLayer) -> float:
    lengths = {i.absorb_below_mm for i in _scatterers(layer)} - {0.0}
    if len(lengths) > 1:
        raise InputError.of(
            f"{layer.name}.absorb_below_mm", sorted(lengths), "must be one length a layer", "Use one length, or none."
        )
    return lengths.pop() if lengths else 0.0


def _regions(layers: Sequence[PlaneLayer], split: bool) -> tuple[tuple[int, int], ...]:
    changes = [split or bool((np.abs(b.n - a.n) > SAME).any()) for a, b in pairwise(layers)]
    starts = [0, *(k + 1 for k, changed in enumerate(changes) if changed)]
    return tuple(zip(starts, [k - 1 for k in starts[1:]] + [len(layers) - 1], strict=True))


def _rows(
    layers: Sequence[PlaneLayer], padded: int, mm_per_unit: float
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], tuple[bool, ...]]:
    edges = cell_edges()
    made: list[NDArray[np.float32]] = []
    known: dict[object, int] = {}
    base, short = np.full((2, len(layers)), -1, dtype=np.int64)
    plain = []

    def table(parts: list[Interaction], width: int) -> int:
        key = tuple((tuple(i.rate * i.albedo), i.phases) for i in parts)
        if key not in known:
            known[key] = len(made) * (len(edges) - 1)
            values = np.full((len(edges) - 1, padded), NEVER, dtype=np.float32)
            for w in range(width):
                density = np.zeros(len(edges) - 1)
                for i in parts:
                    density += i.rate[w] * i.albedo[w] * mm_per_unit * _mean_density(i.phases[w], edges)
                values[:, w] = np.maximum(np.log(np.maximum(density, 1e-300)), NEVER)
            made.append(values)
        return known[key]

    for k, layer in enumerate(layers):
        parts = _scatterers(layer)
        plain.append(_is_plain(parts))
        if parts and not plain[-1]:
            base[k] = table(parts, len(layer.n))
            short[k] = table([i for i in parts if i.absorb_below_mm == 0.0], len(layer.n))
    rows = np.concatenate(made) if made else np.full((1, padded), NEVER, dtype=np.float32)
    return rows, base, short, tuple(plain)


def _is_plain(parts: Sequence[Interaction]) -> bool:
    """Whether all scatter alike, by a law in closed form that is the same at all wavelengths."""
    from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh

    if not parts:
        return True
    first = parts[0].phases[0]
    closed = isinstance(first, Isotropic | Rayleigh | HenyeyGreenstein)
    same = all(p == first for i in parts for p in i.phases)
    return closed and same and len({i.absorb_below_mm for i in parts}) == 1


def cell_edges() -> FloatArray:
    """(N + 1,) edges of the rows' cells in w = 1 − cos θ: 0, then as a float's leading bits count, up to 2."""
    inner = [
        2.0 ** (k + 1 - OCTAVES + 1) * (1.0 + np.arange(CELLS_PER_OCTAVE) / CELLS_PER_OCTAVE)
        for k in range(-1, OCTAVES - 1)
    ]
    return np.concatenate([[0.0], *inner, [2.0]])


def _mean_density(phase: Phase, edges: FloatArray) -> FloatArray:
    cdf = getattr(phase, "cdf_complement", None)
    cumulative = cdf(edges) if cdf is not None else 1.0 - phase.cdf(1.0 - edges)
    return np.asarray(np.diff(cumulative) / (2.0 * math.pi * np.diff(edges)))


def _reflectances(index: FloatArray, padded: int) -> tuple[NDArray[np.float32], tuple[bool, ...], tuple[bool, ...]]:
    node, weight = np.polynomial.legendre.leggauss(4)
    cosine = (np.arange(FRESNEL_CELLS)[:, None] + 0.5 * (node + 1.0)) / FRESNEL_CELLS
    count = len(index) - 1
    values = np.zeros((count, 2, FRESNEL_CELLS, padded), dtype=np.float32)
    refracts, dispersive = [], []
    for r in range(count):
        for w in range(index.shape[1]):
            pair = index[r, w], index[r + 1, w]
            for side, (a, b) in enumerate((pair, pair[::-1])):
                values[r, side, :, w] = fresnel(a, b, cosine) @ weight * 0.5
        ratio = index[r] / index[r + 1]
        refracts.append(bool((np.abs(ratio - 1.0) > SAME).any()))
        dispersive.append(bool(np.ptp(ratio) > 1e-6))
    return values, tuple(refracts), tuple(dispersive)
