"""What a ledger holds: coefficients, anchors, and one row a photon (or a bin of photons) that left the stack."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.stack import REDIRECT_MEAN, OpticalStack
from livlab.model.transport.tally import Tally
from livlab.units import FloatArray

Side = Literal["up", "down", "side", "residual"]
SIDES: tuple[Side, ...] = ("up", "down", "side", "residual")
"""How a photon ended; its code is its place here."""

OUTSIDE = -1
"""Bin of light beyond the edges of the tally."""


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of S settings (wavelengths, parameter sets) of L layers.

    Attributes
    ----------
    wavelength_nm
        (S,) nm.
    thickness_mm
        (L,) mm.
    absorption, scattering
        (S, L) 1/mm, `PlaneLayer.absorption` and `.scattering`: what a factor of Algorithm 2 takes on average counts
        as absorption.
    anisotropy
        (S, L) mean cosine; 0 where nothing scatters.
    index
        (S, L + 2) refractive indices from above to below.
    """

    wavelength_nm: FloatArray
    thickness_mm: FloatArray
    absorption: FloatArray
    scattering: FloatArray
    anisotropy: FloatArray
    index: FloatArray

    @classmethod
    def of(cls, stack: OpticalStack) -> Coefficients:
        """Those of a stack; of its phase functions only the mean cosines are asked."""
        width = len(stack.wavelength_nm)
        index = np.stack([stack.n_above, *(x.n for x in stack.layers), stack.n_below], axis=1)
        if math.isinf(stack.layers[-1].thickness_mm):
            index[:, -1] = index[:, -2]
        known: dict[int, float] = {}

        def mean_cosine(phase: Phase) -> float:
            if id(phase) not in known:
                known[id(phase)] = phase.anisotropy
            return known[id(phase)]

        g = np.zeros((width, len(stack.layers)))
        scattering = np.stack([x.scattering for x in stack.layers], axis=1)
        for k, layer in enumerate(stack.layers):
            for i in layer.interactions:
                share = i.rate * i.albedo * REDIRECT_MEAN[i.redirect]
                if share.any():
                    g[:, k] += share * [mean_cosine(p) if s > 0 else 0.0 for p, s in zip(i.phases, share, strict=True)]
        g = np.divide(g, scattering, out=np.zeros_like(g), where=scattering > 0)
        return cls(
            np.asarray(stack.wavelength_nm, dtype=np.float64),
            np.array([x.thickness_mm for x in stack.layers]),
            np.maximum(np.stack([x.absorption for x in stack.layers], axis=1), 0.0),
            scattering,
            g,
            index,
        )

    def __len__(self) -> int:
        return len(self.wavelength_nm)

    @classmethod
    def joined(cls, parts: Sequence[Coefficients]) -> Coefficients:
        """Settings of the same layers, one after the other."""
        first = parts[0]
        return cls(
            np.concatenate([x.wavelength_nm for x in parts]),
            first.thickness_mm,
            np.concatenate([x.absorption for x in parts]),
            np.concatenate([x.scattering for x in parts]),
            np.concatenate([x.anisotropy for x in parts]),
            np.concatenate([x.index for x in parts]),
        )

    def take(self, rows: Sequence[int] | NDArray[np.int64]) -> Coefficients:
        """Some of the settings."""
        ix = np.asarray(rows)
        return Coefficients(
            self.wavelength_nm[ix],
            self.thickness_mm,
            self.absorption[ix],
            self.scattering[ix],
            self.anisotropy[ix],
            self.index[ix],
        )

    def at(self, wavelength_nm: FloatArray) -> Coefficients:
        """Interpolated linearly between the settings, which must be sorted by wavelength.

        Raises
        ------
        InputError
            Beyond the first and last wavelength.
        """
        wanted = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        bad = ~((wanted >= low - 1e-9) & (wanted <= high + 1e-9))
        if bad.any():
            raise InputError.of(
                "wavelength_nm",
                float(wanted[bad][0]),
                f"must be within the recorded band [{low:g}, {high:g}] nm",
                "Record a ledger of a band that holds it.",
            )

        def between(values: FloatArray) -> FloatArray:
            return np.stack([np.interp(wanted, self.wavelength_nm, x) for x in values.T], axis=1)

        return Coefficients(
            wanted,
            self.thickness_mm,
            between(self.absorption),
            between(self.scattering),
            between(self.anisotropy),
            between(self.index),
        )

    def fitted(self, thickness_mm: FloatArray) -> Coefficients:
        """The same optical depths in layers of other thicknesses: only µ d matters to what leaves endless layers."""
        ratio = np.ones_like(thickness_mm)
        finite = np.isfinite(self.thickness_mm) & np.isfinite(thickness_mm)
        ratio[finite] = self.thickness_mm[finite] / thickness_mm[finite]
        return Coefficients(
            self.wavelength_nm,
            np.asarray(thickness_mm),
            self.absorption * ratio,
            self.scattering * ratio,
            self.anisotropy,
            self.index,
        )


@dataclass(frozen=True)
class Anchors:
    """The K walks of a ledger, each with the phase functions and indices of one wavelength.

    Attributes
    ----------
    wavelength_nm
        (K,) nm.
    scattering, extinction, anisotropy
        (K, L) the coefficients walked with, 1/mm: a path of n scatterings and length ℓ was drawn with density
        ∝ scatteringⁿ e^(−extinction ℓ).
    index
        (K, L + 2).
    photons
        (K,) photons walked.
    """

    wavelength_nm: FloatArray
    scattering: FloatArray
    extinction: FloatArray
    anisotropy: FloatArray
    index: FloatArray
    photons: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.wavelength_nm)

    @property
    def absorption(self) -> FloatArray:
        """(K, L) the reference absorption in 1/mm."""
        return np.maximum(self.extinction - self.scattering, 0.0)


@dataclass(frozen=True)
class Entries:
    """Rows sorted by anchor, side and bin.

    A photon that left with weight w after paths ℓ and n scatterings is a row (ln w, ℓ, n). A bin of several
    is one row too: at coefficients whose exponents are θ it counts e^(log_weight + θ·features), and the
    squares of its photons' weights sum to that number squared times `concentration`.

    Attributes
    ----------
    anchor, side, bin
        (N,) which walk; code of `SIDES`; bin of the tally (θ first, then radius), `OUTSIDE` if none.
    features
        (N, F) float32: path length in each layer in mm, then scatterings in each counted layer.
    log_weight, concentration
        (N,) float32.
    cosine, radius
        (N,) float32 of the exit: cosine with the normal outside, distance from the origin in mm; empty in a
        compressed ledger, which knows only the bins (radius also where places were not followed).
    """

    anchor: NDArray[np.uint16]
    side: NDArray[np.uint8]
    bin: NDArray[np.int32]
    features: NDArray[np.float32]
    log_weight: NDArray[np.float32]
    concentration: NDArray[np.float32]
    cosine: NDArray[np.float32]
    radius: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.anchor)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return sum(x.nbytes for x in self.arrays().values())

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """All by name."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def digest(self) -> str:
        """SHA-256 over the content."""
        found = hashlib.sha256()
        for name, values in self.arrays().items():
            found.update(f"{name} {values.dtype.str} {values.shape}".encode())
            found.update(np.ascontiguousarray(values).tobytes())
        return found.hexdigest()


def sort_entries(entries: Entries) -> Entries:
    """Rows in the order that `Entries` promises."""
    bins = int(entries.bin.max(initial=OUTSIDE)) + 2
    key = (entries.anchor.astype(np.int64) * len(SIDES) + entries.side) * bins + entries.bin + 1
    if key.max(initial=0) < 1 << 16:
        key = key.astype(np.uint16)  # sorted by digits, in linear time
    if (key[1:] >= key[:-1]).all():
        return entries
    order = np.argsort(key, kind="stable")
    return Entries(**{k: v[order] if len(v) == len(order) else v for k, v in entries.arrays().items()})  # type: ignore[arg-type]


def bins_of(tally: Tally, cosine: NDArray[np.float32], radius: NDArray[np.float32]) -> NDArray[np.int32]:
    """Bin of each exit, θ first; the walk's own rule (rounding beyond an outermost edge is taken in)."""
    if not tally.binned:
        return np.zeros(len(cosine), dtype=np.int32)
    edges = tally.minus_cosines
    t = np.searchsorted(edges, -cosine, side="right") - 1
    good = (t >= 0) & (t < len(edges) - 1)
    count = len(tally.radius) - 1
    r = np.zeros_like(t)
    if tally.radius_edges:
        r = np.searchsorted(np.asarray(tally.radius), radius, side="right") - 1
        good &= (r >= 0) & (r < count)
    return np.where(good, t * count + r, OUTSIDE).astype(np.int32)


@dataclass(frozen=True)
class Compression:
    """How a ledger was binned.

    Attributes
    ----------
    rows_before
        Rows of the recorded ledger.
    tolerance, error
        Wanted and measured largest difference of any answer from that of the recorded ledger, over the settings
        checked, as a share of the incident light.
    low, high
        (K, F) bounds of the exponents for which the bins were made.
    """

    rows_before: int
    tolerance: float
    error: float
    low: FloatArray
    high: FloatArray

    def holds(self, k: int, theta: FloatArray) -> NDArray[np.bool_]:
        """(S,) whether exponents (F, S) lie within the bounds of anchor k."""
        margin = 1e-6 * (1.0 + np.abs(theta))
        inside = (theta + margin >= self.low[k][:, None]) & (theta - margin <= self.high[k][:, None])
        return np.asarray(inside.all(axis=0))


@dataclass(frozen=True)
class Detector:
    """Which of the light that leaves counts; make it by `total`, `cone` or `annulus`.

    Attributes
    ----------
    side
        "up" (reflected), "down" (transmitted), "side" (lost at the sides), "residual" (given up).
    theta
        Range of the exit angle from the normal, outside, in radians.
    radius
        Range of the exit's distance from the origin in mm.
    """

    side: Side = "up"
    theta: tuple[float, float] = (0.0, math.pi / 2)
    radius: tuple[float, float] = (0.0, math.inf)

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise InputError.of("detector.side", self.side, f"must be one of {', '.join(SIDES)}", "Name one.")
        for name, (low, high), top in (("theta", self.theta, math.pi / 2), ("radius", self.radius, math.inf)):
            if not 0.0 <= low < high <= top * (1 + 1e-12):
                raise InputError.of(
                    f"detector.{name}", (low, high), f"must be increasing within [0, {top:g}]", "Give low and high."
                )

    @classmethod
    def total(cls, side: Side = "up") -> Detector:
        """All of it."""
        return cls(side)

    @classmethod
    def cone(cls, half_angle_rad: float, side: Side = "up") -> Detector:
        """Light within a cone about the normal.

        >>> Detector.cone(0.1).theta
        (0.0, 0.1)
        """
        return cls(side, theta=(0.0, half_angle_rad))

    @classmethod
    def annulus(cls, inner_mm: float, outer_mm: float, side: Side = "up") -> Detector:
        """Light that leaves between two radii."""
        return cls(side, radius=(inner_mm, outer_mm))

    @property
    def everything(self) -> bool:
        """Whether no angle and no radius is left out."""
        return self.theta[0] == 0.0 and self.theta[1] >= math.pi / 2 and self.radius == (0.0, math.inf)
