"""The optical stack: what transport needs to know of a tissue, and nothing else.

A tissue (elements, layers, states) is turned by `livlab.model.tissue.optics` into plane layers whose
elements have rates, albedos and phase functions at each wavelength. Every solver reads this form.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from livlab.errors import InputError
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import mixture
from livlab.units import FloatArray

Redirect = Literal["none", "abs_cos", "cos", "clamped_cos"]
"""Factor on the intensity at a redirection (Nunes 2019, Algorithm 2): none, |cos θ|, cos θ, max(0, cos θ),
θ being the azimuth of the new direction in the sample's frame (z along the normal)."""

REDIRECT_MEAN: dict[Redirect, float] = {
    "none": 1.0,
    "abs_cos": 2.0 / math.pi,
    "cos": 0.0,
    "clamped_cos": 1.0 / math.pi,
}
"""Mean of the factor over a uniform azimuth: the albedo that Algorithm 2 leaves in expectation."""


@dataclass(frozen=True)
class Interaction:
    """One element of a layer as the walk meets it.

    Attributes
    ----------
    name
        The element ("collagen", "blood", ...).
    rate
        (W,) rate in 1/mm of its exponential draws (Nunes 2019, eq. 6.18; 6.19 for the hepatocyte).
    albedo
        (W,) probability to survive a meeting: 0 for an absorber, 1 for a scatterer.
    phases
        (W,) phase functions, one a wavelength (the same object may repeat); unused where albedo is 0.
    redirect
        Factor of Algorithm 2 at each redirection.
    absorb_below_mm
        Algorithm 1 for attenuating elements: a free path shorter than this ends in absorption.
        The path counts from the last draw (a meeting, an interface or the entry).
    """

    name: str
    rate: FloatArray
    albedo: FloatArray
    phases: tuple[Phase, ...]
    redirect: Redirect = "none"
    absorb_below_mm: float = 0.0

    def __post_init__(self) -> None:
        _check(f"{self.name}.rate", self.rate, 0.0, math.inf)
        _check(f"{self.name}.albedo", self.albedo, 0.0, 1.0)
        if not (len(self.rate) == len(self.albedo) == len(self.phases)):
            raise InputError.of(
                f"{self.name}",
                (len(self.rate), len(self.albedo), len(self.phases)),
                "rate, albedo and phases must have one entry a wavelength",
                "Give arrays of equal length.",
            )


@dataclass(frozen=True)
class PlaneLayer:
    """A plane layer: thickness in mm (may be inf for the last), index n (W,), and its elements."""

    name: str
    thickness_mm: float
    n: FloatArray
    interactions: tuple[Interaction, ...] = ()

    def __post_init__(self) -> None:
        if not self.thickness_mm > 0:
            raise InputError.of(
                f"{self.name}.thickness_mm", self.thickness_mm, "must be > 0", "Drop the layer or give it a thickness."
            )
        _check(f"{self.name}.n", self.n, 0.1, 10.0)

    @property
    def absorption(self) -> FloatArray:
        """(W,) µ_a in 1/mm: Σ rate (1 − albedo · mean redirect factor), short free paths not counted."""
        total = np.zeros_like(self.n)
        for i in self.interactions:
            total = total + i.rate * (1.0 - i.albedo * REDIRECT_MEAN[i.redirect])
        return total

    @property
    def scattering(self) -> FloatArray:
        """(W,) µ_s in 1/mm: Σ rate · albedo · mean redirect factor, short free paths not counted."""
        total = np.zeros_like(self.n)
        for i in self.interactions:
            total = total + i.rate * i.albedo * REDIRECT_MEAN[i.redirect]
        return total

    def phase(self, index: int) -> Phase:
        """The layer's phase function at one wavelength: its scatterers' mixture, weighted by scattering."""
        parts = [i for i in self.interactions if i.rate[index] * i.albedo[index] > 0]
        weights = [float(i.rate[index] * i.albedo[index] * REDIRECT_MEAN[i.redirect]) for i in parts]
        return mixture([i.phases[index] for i in parts], weights)


@dataclass(frozen=True)
class OpticalStack:
    """Plane layers from the lit side down, at W wavelengths in nm, between two clear half-spaces."""

    wavelength_nm: FloatArray
    layers: tuple[PlaneLayer, ...]
    n_above: FloatArray
    n_below: FloatArray
    name: str = "stack"
    notes: tuple[str, ...] = field(default=())
    """Warnings that a report must show (an efficiency above its physical bound, say)."""

    def __post_init__(self) -> None:
        _check("wavelength_nm", self.wavelength_nm, 1.0, 1e6)
        if not self.layers:
            raise InputError.of("layers", (), "at least one layer is needed", "Add a layer.")
        for layer in self.layers[:-1]:
            if math.isinf(layer.thickness_mm):
                raise InputError.of(
                    f"{layer.name}.thickness_mm",
                    layer.thickness_mm,
                    "only the last layer may be infinite",
                    "Give it a thickness.",
                )
        for what, values in [
            ("n_above", self.n_above),
            ("n_below", self.n_below),
            *((f"{x.name}.n", x.n) for x in self.layers),
        ]:
            if len(values) != len(self.wavelength_nm):
                raise InputError.of(
                    what,
                    len(values),
                    f"must have {len(self.wavelength_nm)} entries, one a wavelength",
                    "Give one value a wavelength.",
                )

    def at(self, indices: Sequence[int]) -> OpticalStack:
        """The same stack at some of its wavelengths."""
        ix = np.asarray(indices, dtype=int)
        layers = tuple(
            PlaneLayer(
                x.name,
                x.thickness_mm,
                x.n[ix],
                tuple(
                    Interaction(
                        i.name, i.rate[ix], i.albedo[ix], tuple(i.phases[k] for k in ix), i.redirect, i.absorb_below_mm
                    )
                    for i in x.interactions
                ),
            )
            for x in self.layers
        )
        return OpticalStack(self.wavelength_nm[ix], layers, self.n_above[ix], self.n_below[ix], self.name, self.notes)


def plain_stack(
    layers: Sequence[tuple[float, float, float, float, Phase]],
    *,
    n_above: float = 1.0,
    n_below: float = 1.0,
    wavelength_nm: float = 500.0,
) -> OpticalStack:
    """One-wavelength stack from (n, µ_a, µ_s, thickness, phase) in 1/mm and mm: the textbook's slab."""
    one = np.ones(1)
    made = []
    for k, (n, mua, mus, thickness, phase) in enumerate(layers):
        parts = (
            Interaction("absorber", mua * one, 0 * one, (phase,)),
            Interaction("scatterer", mus * one, one, (phase,)),
        )
        made.append(PlaneLayer(f"layer {k}", thickness, n * one, parts))
    return OpticalStack(wavelength_nm * one, tuple(made), n_above * one, n_below * one, "plain")


def _check(what: str, values: FloatArray, low: float, high: float) -> None:
    values = np.asarray(values)
    if values.ndim != 1 or values.size == 0:
        raise InputError.of(
            what, values.shape, "must be a non-empty one-dimensional array", "Give one value a wavelength."
        )
    bad = ~(np.isfinite(values) & (values >= low) & (values <= high))
    if bad.any():
        raise InputError.of(
            what, float(values[bad][0]), f"must be finite and within [{low:g}, {high:g}]", "Mend the value."
        )
