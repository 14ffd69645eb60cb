"""From an optical stack to the arrays of the walk: numbers in tables, and the few facts that shape its code."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from livlab.model.tissue.particles.cylinder_lazy import prepare
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh, kernel_table
from livlab.model.tissue.stack import REDIRECT_MEAN, OpticalStack, PlaneLayer, Redirect
from livlab.units import FloatArray

Estimator = Literal["expected", "analog"]

ISOTROPIC, RAYLEIGH, HENYEY_GREENSTEIN, TABULATED = range(4)
CELLS_PER_OCTAVE = 128
"""Fineness of the inverse distributions: 1 − g is kept to 1e-5 of itself, in 20 kB a phase function."""

REDIRECTS: tuple[Redirect, ...] = ("none", "abs_cos", "cos", "clamped_cos")
"""A redirection's code is its place here."""

FOCUS: dict[Redirect, float] = {
    "none": 1.0,
    "abs_cos": REDIRECT_MEAN["abs_cos"],
    "cos": REDIRECT_MEAN["abs_cos"],
    "clamped_cos": REDIRECT_MEAN["clamped_cos"],
}
"""Magnitude of the factor when the azimuth is drawn in proportion to it: ∫|f| dθ/2π."""


@dataclass(frozen=True)
class Shape:
    """What the code of a kernel depends on; everything else is data.

    Attributes
    ----------
    layers
        Number of layers.
    ways
        Largest number of elements (analog) or of scattering ways (expected) in a layer.
    kinds
        Codes of the phase functions in use.
    redirects
        Codes of the redirect factors in use.
    short
        Whether some element absorbs below a free path.
    fresnel
        Whether any two neighbouring indices differ.
    """

    estimator: Estimator
    layers: int
    ways: int
    kinds: tuple[int, ...]
    redirects: tuple[int, ...]
    short: bool
    fresnel: bool

    @property
    def only(self) -> int | None:
        """The one kind of phase function in use, if there is one."""
        return self.kinds[0] if len(self.kinds) == 1 else None

    @property
    def steered(self) -> bool:
        """Whether a redirect factor may meet a phase function that is not isotropic: it needs directions in space."""
        return self.redirects != (0,) and self.kinds != (ISOTROPIC,)


@dataclass(frozen=True)
class Tables:
    """Coefficients by layer, way and wavelength.

    Attributes
    ----------
    thickness
        (L,) mm.
    index
        (L + 2, W) indices from the medium above to the one below an infinite last layer's own.
    mfp
        expected: (L, 1, W) mean free path of the summed rate; analog: (L, E, W) of each element; inf where 0.
    survive
        expected: (L, C, W) Σ rate·albedo of the way's elements / Σ rate; analog: (L, E, W) albedo.
    loss
        expected: (L, 1, W) Σ rate·(1 − albedo) / Σ rate; analog: (L, E, W) 1 − albedo. Single precision knows
        an albedo of 1 − 1e-9 by this only.
    below
        (L, ways) absorb_below_mm.
    redirect
        (L, ways) code.
    kind, g, offset
        (L, ways, W) phase code, anisotropy for the closed form, and start of its table.
    table
        Inverse distributions one after the other (`livlab.model.tissue.phase.functions.KernelTable`).
    table_shift, table_base, table_row, table_octaves
        Their layout.
    """

    shape: Shape
    thickness: FloatArray
    index: FloatArray
    mfp: FloatArray
    survive: FloatArray
    loss: FloatArray
    below: FloatArray
    redirect: NDArray[np.int64]
    kind: NDArray[np.int64]
    g: FloatArray
    offset: NDArray[np.int64]
    table: NDArray[np.float32]
    table_shift: int
    table_base: int
    table_row: int
    table_octaves: int


@dataclass(frozen=True)
class _Way:
    """One thing that can happen in a layer: an element, or all that scatter alike."""

    survive: FloatArray
    phases: tuple[Phase, ...]
    redirect: int
    below: float


def tables(stack: OpticalStack, estimator: Estimator) -> Tables:
    """Lay a stack out for the kernel of one estimator."""
    made = [_elements(x) if estimator == "analog" else _grouped(x) for x in stack.layers]
    count = max(1, *(len(ways) for _, ways in made))
    layers, width = len(stack.layers), len(stack.wavelength_nm)
    mfp = np.full((layers, count if estimator == "analog" else 1, width), math.inf)
    survive = np.zeros((layers, count, width))
    loss = np.zeros_like(mfp)
    below = np.zeros((layers, count))
    redirect = np.zeros((layers, count), dtype=np.int64)
    kind = np.full((layers, count, width), -1, dtype=np.int64)
    g = np.zeros((layers, count, width))
    offset = np.zeros((layers, count, width), dtype=np.int64)
    store = _Store()
    prepare(p for _, ways in made for way in ways for p, s in zip(way.phases, way.survive, strict=True) if s > 0)
    for k, (rates, ways) in enumerate(made):
        for e, rate in enumerate(rates):
            with np.errstate(divide="ignore"):
                mfp[k, e] = 1.0 / rate
        for e, share in enumerate(_losses(stack.layers[k], estimator)):
            loss[k, e] = share
        for c, way in enumerate(ways):
            survive[k, c], below[k, c] = way.survive, way.below
            scatters = way.survive > 0
            redirect[k, c] = way.redirect if scatters.any() else 0
            for w in np.flatnonzero(scatters):
                kind[k, c, w], g[k, c, w], offset[k, c, w] = store.add(way.phases[w])
    kinds = tuple(sorted(set(np.unique(kind[kind >= 0]).tolist()))) or (ISOTROPIC,)
    kind[kind < 0] = kinds[0]
    index = np.stack([stack.n_above, *(x.n for x in stack.layers), stack.n_below])
    if math.isinf(stack.layers[-1].thickness_mm):
        index[-1] = index[-2]
    shape = Shape(
        estimator,
        layers,
        count,
        kinds,
        tuple(sorted(set(redirect.ravel().tolist()))),
        bool((below > 0).any()),
        bool((np.diff(index, axis=0) != 0).any()),
    )
    thickness = np.array([x.thickness_mm for x in stack.layers])
    return Tables(
        shape=shape,
        thickness=thickness,
        index=index,
        mfp=mfp,
        survive=survive,
        loss=loss,
        below=below,
        redirect=redirect,
        kind=kind,
        g=g,
        offset=offset,
        table=store.table(),
        **store.layout,
    )


def _losses(layer: PlaneLayer, estimator: Estimator) -> list[FloatArray]:
    """Chance that a collision absorbs, without the short free paths: by element, or of all together."""
    if estimator == "analog":
        return [1.0 - i.albedo for i in layer.interactions if i.rate.any()]
    total = sum((i.rate for i in layer.interactions), np.zeros_like(layer.n))
    absorption = sum((i.rate * (1.0 - i.albedo) for i in layer.interactions), np.zeros_like(layer.n))
    return [np.divide(absorption, total, out=np.zeros_like(total), where=total > 0)]


def _elements(layer: PlaneLayer) -> tuple[list[FloatArray], list[_Way]]:
    """Analog: every element that interacts at all, as it is."""
    parts = [i for i in layer.interactions if i.rate.any()]
    ways = [_Way(i.albedo, i.phases, REDIRECTS.index(i.redirect), i.absorb_below_mm) for i in parts]
    return [i.rate for i in parts], ways


def _grouped(layer: PlaneLayer) -> tuple[list[FloatArray], list[_Way]]:
    """Expected: the summed rate, and scatterers merged where they do the same.

    Unlike phase functions stay apart and are chosen by their share in the kernel: a table of every mixture,
    one a layer and wavelength, would take longer to make than the walk.
    """
    total = sum((i.rate for i in layer.interactions), np.zeros_like(layer.n))
    groups: dict[tuple[int, float, tuple[Phase, ...]], FloatArray] = {}
    for i in layer.interactions:
        scattering = i.rate * i.albedo
        if scattering.any():
            key = (REDIRECTS.index(i.redirect), i.absorb_below_mm, i.phases)
            groups[key] = groups.get(key, np.zeros_like(total)) + scattering
    ways = []
    for (redirect, below, phases), scattering in groups.items():
        share = np.divide(scattering, total, out=np.zeros_like(total), where=total > 0)
        ways.append(_Way(np.minimum(share, 1.0), phases, redirect, below))
    return [total], ways


@lru_cache(maxsize=1024)
def _table(phase: Any) -> NDArray[np.float32]:
    return kernel_table(phase, per_octave=CELLS_PER_OCTAVE).values.ravel()


class _Store:
    """The distinct phase functions met so far, one table each."""

    def __init__(self) -> None:
        self._seen: dict[Phase, int] = {}
        self._rows: list[NDArray[np.float32]] = []
        self._size = 0
        first = kernel_table(Isotropic(), per_octave=CELLS_PER_OCTAVE)
        self.layout = {
            "table_shift": first.shift,
            "table_base": first.base,
            "table_row": first.values.shape[1],
            "table_octaves": first.octaves,
        }

    def add(self, phase: Phase) -> tuple[int, float, int]:
        """Kind, anisotropy and offset of a phase function."""
        if isinstance(phase, Isotropic):
            return ISOTROPIC, 0.0, 0
        if isinstance(phase, Rayleigh):
            return RAYLEIGH, 0.0, 0
        if isinstance(phase, HenyeyGreenstein):
            return (HENYEY_GREENSTEIN, phase.g, 0) if phase.g != 0.0 else (ISOTROPIC, 0.0, 0)
        if phase not in self._seen:
            self._seen[phase] = self._size
            hashable: Any = phase  # the protocol does not say so, every phase function of livlab is
            self._rows.append(_table(hashable))
            self._size += self._rows[-1].size
        return TABULATED, 0.0, self._seen[phase]

    def table(self) -> NDArray[np.float32]:
        """All tables, one after the other."""
        return np.concatenate(self._rows) if self._rows else np.zeros(1, dtype=np.float32)
