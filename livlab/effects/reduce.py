"""Cheaper equivalents of a stack: pure functions, each of which leaves one effect out.

A function that does not find what it leaves out (because another has taken it already) returns the stack as it is,
so any number of them can follow each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from livlab.model.tissue.particles.cylinder_lazy import settled
from livlab.model.tissue.phase.base import Phase
from livlab.model.tissue.phase.functions import Isotropic, Tabulated, mixture
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.units import FloatArray

Names = frozenset[str]
"""Names of layers, sublayers written out."""

_TAIL_POINTS = 180


def without_layers(stack: OpticalStack, names: Names) -> OpticalStack:
    """The stack without some layers; as it is if none would be left."""
    kept = tuple(x for x in stack.layers if x.name not in names)
    return replace(stack, layers=kept) if kept else stack


def without_element(stack: OpticalStack, element: str, layers: Names) -> OpticalStack:
    """The stack without an element in some layers."""
    return _with_parts(stack, layers, lambda parts: tuple(i for i in parts if i.name != element))


def without_scattering(stack: OpticalStack, layers: Names) -> OpticalStack:
    """The stack without scattering in some layers; what an element absorbs stays."""

    def clear(i: Interaction) -> Interaction:
        # A path shorter than absorb_below_mm is no absorption of its own: it goes with the scattering.
        return replace(i, rate=i.rate * (1.0 - i.albedo), albedo=np.zeros_like(i.albedo), absorb_below_mm=0.0)

    return _with_parts(stack, layers, lambda parts: tuple(clear(i) if i.albedo.any() else i for i in parts))


def with_rates(stack: OpticalStack, rates: Mapping[tuple[str, str], FloatArray]) -> OpticalStack:
    """The stack with other rates of some (layer, element)."""

    def changed(layer: PlaneLayer) -> PlaneLayer:
        parts = tuple(replace(i, rate=rates.get((layer.name, i.name), i.rate)) for i in layer.interactions)
        return replace(layer, interactions=parts)

    return replace(stack, layers=tuple(changed(x) for x in stack.layers))


def merged(stack: OpticalStack, names: Names, name: str) -> OpticalStack:
    """The stack with neighbouring layers of one index as one layer of their mean composition.

    Rates are averaged by thickness, so that every element keeps its optical depth; phase functions by scattering.
    """
    where = [k for k, x in enumerate(stack.layers) if x.name in names]
    if len(where) < 2:
        return stack
    parts = [stack.layers[k] for k in where]
    if where[-1] - where[0] + 1 != len(where) or any(not np.array_equal(x.n, parts[0].n) for x in parts):
        return stack
    total = math.fsum(x.thickness_mm for x in parts)
    if math.isinf(total):
        return stack
    found: dict[tuple[str, str, float], list[tuple[float, Interaction]]] = {}
    for x in parts:
        for i in x.interactions:
            found.setdefault((i.name, i.redirect, i.absorb_below_mm), []).append((x.thickness_mm / total, i))
    one = PlaneLayer(name, total, parts[0].n, tuple(_mean(shares) for shares in found.values()))
    return replace(stack, layers=(*stack.layers[: where[0]], one, *stack.layers[where[-1] + 1 :]))


def _mean(shares: list[tuple[float, Interaction]]) -> Interaction:
    first = shares[0][1]
    rate = np.sum([share * i.rate for share, i in shares], axis=0)
    scattering = np.array([share * i.rate * i.albedo for share, i in shares])
    albedo = np.divide(scattering.sum(axis=0), rate, out=np.zeros_like(rate), where=rate > 0)
    phases = tuple(mixture([i.phases[w] for _, i in shares], scattering[:, w].tolist()) for w in range(len(rate)))
    return replace(first, rate=rate, albedo=np.minimum(albedo, 1.0), phases=phases)


def similar(stack: OpticalStack, layers: Names) -> OpticalStack:
    """The stack with scattering in some layers isotropic, µs (1 − g) in place of µs (van de Hulst 1980, ch. 14)."""
    return _rescattered(stack, layers, lambda phase: (Isotropic(), 1.0 - phase.anisotropy))


def widened(stack: OpticalStack, layers: Names, angle_deg: float) -> OpticalStack:
    """The stack with the small angles of scattering in some layers spread over a cone; see `widened_phase`."""
    return _rescattered(stack, layers, lambda phase: widened_phase(phase, angle_deg))


def widened_phase(phase: Phase, angle_deg: float) -> tuple[Phase, float]:
    """A phase function without its forward peak, and the share of the scattering that is left.

    Beyond the angle θc it is µs p, unchanged. Within, p is replaced by A + B (1 − cos θ), continuous at θc and with
    the same ∫ (1 − cos θ) p dΩ, so that µs (1 − g) is kept exactly: many small deflections become few larger ones
    that turn the light as much. θc → 0 is the phase function itself, θc → 180° nearly the similarity relation.

    Parameters
    ----------
    phase
        The phase function.
    angle_deg
        θc in degrees, in (0, 180).

    Returns
    -------
    The phase function and its share s ≤ 1: µs becomes s µs. The phase itself and 1 where nothing is gained, or where
    no A + B (1 − cos θ) ≥ 0 fits.

    Examples
    --------
    >>> from livlab.model.tissue.phase.functions import HenyeyGreenstein
    >>> wide, share = widened_phase(HenyeyGreenstein(0.95), 60.0)
    >>> round(float(share), 3), round(float(share * (1 - wide.anisotropy)), 12)
    (0.156, 0.05)
    """
    edge = 2.0 * math.sin(0.5 * math.radians(angle_deg)) ** 2
    phase = settled(phase)
    if isinstance(phase, Tabulated):
        points = phase.complement[phase.complement > edge * (1.0 + 1e-12)]
        tail = np.concatenate([[edge], points])
    else:
        tail = np.geomspace(edge, 2.0, _TAIL_POINTS)
        tail[0], tail[-1] = edge, 2.0
    values = np.asarray(phase.pdf(1.0 - tail), dtype=np.float64)
    step = np.diff(tail)
    turned = (values[:-1] * (2 * tail[:-1] + tail[1:]) + values[1:] * (tail[:-1] + 2 * tail[1:])) * step / 6.0
    mass = math.fsum(0.5 * (values[1:] + values[:-1]) * step)
    moment = (1.0 - phase.anisotropy) / (2.0 * math.pi) - math.fsum(turned)
    slope = (0.5 * values[0] * edge**2 - moment) * 6.0 / edge**3
    top = values[0] - slope * edge
    share = 2.0 * math.pi * (mass + edge * (top + 0.5 * slope * edge))
    if top < 0.0 or not 0.0 < share < 1.0:
        return phase, 1.0
    return Tabulated.from_complement(np.concatenate([[0.0], tail]), np.concatenate([[top], values])), share


def matched_surface(stack: OpticalStack) -> OpticalStack:
    """The stack under a medium of its own index: no Fresnel reflection where light enters and leaves."""
    return replace(stack, n_above=stack.layers[0].n)


def matched_interface(stack: OpticalStack, upper: Names, lower: Names) -> OpticalStack:
    """The stack without the step of index between two layers: the thinner side takes the index of the thicker."""
    layers = stack.layers
    for k in range(len(layers) - 1):
        if layers[k].name not in upper or layers[k + 1].name not in lower:
            continue
        if np.array_equal(layers[k].n, layers[k + 1].n):
            return stack
        first, last = k, k + 1
        while first > 0 and np.array_equal(layers[first - 1].n, layers[k].n):
            first -= 1
        while last < len(layers) - 1 and np.array_equal(layers[last + 1].n, layers[k + 1].n):
            last += 1
        above = math.fsum(x.thickness_mm for x in layers[first : k + 1])
        below = math.fsum(x.thickness_mm for x in layers[k + 1 : last + 1])
        changed = range(first, k + 1) if above <= below else range(k + 1, last + 1)
        n = layers[k + 1].n if above <= below else layers[k].n
        return replace(stack, layers=tuple(replace(x, n=n) if j in changed else x for j, x in enumerate(layers)))
    return stack


def without_dispersion(stack: OpticalStack) -> OpticalStack:
    """The stack with every index at its mean over the wavelengths."""

    def mean(n: FloatArray) -> FloatArray:
        return np.full_like(n, float(np.mean(n)))

    layers = tuple(replace(x, n=mean(x.n)) for x in stack.layers)
    return replace(stack, layers=layers, n_above=mean(stack.n_above), n_below=mean(stack.n_below))


def endless(stack: OpticalStack) -> OpticalStack:
    """The stack with its last layer semi-infinite: nothing is transmitted."""
    return replace(stack, layers=(*stack.layers[:-1], replace(stack.layers[-1], thickness_mm=math.inf)))


def more_absorbing(stack: OpticalStack, by: FloatArray) -> OpticalStack:
    """The stack with `by` (W,) ≥ 0 in 1/mm more absorption in every layer."""
    extra = Interaction("(more absorption)", by, np.zeros_like(by), (Isotropic(),) * len(by))
    return replace(stack, layers=tuple(replace(x, interactions=(*x.interactions, extra)) for x in stack.layers))


def plain_scatterer(i: Interaction) -> bool:
    """Whether an element scatters and neither a redirect factor nor a shortest free path goes with each scattering."""
    return bool((i.rate * i.albedo).any()) and i.redirect == "none" and i.absorb_below_mm == 0.0


def _rescattered(stack: OpticalStack, layers: Names, change: Callable[[Phase], tuple[Phase, float]]) -> OpticalStack:
    known: dict[int, tuple[Phase, tuple[Phase, float]]] = {}

    def of(phase: Phase) -> tuple[Phase, float]:
        if id(phase) not in known:
            known[id(phase)] = (phase, change(phase))
        return known[id(phase)][1]

    def turned(i: Interaction) -> Interaction:
        made = [of(p) for p in i.phases]
        scattering = i.rate * i.albedo * np.array([share for _, share in made])
        rate = scattering + i.rate * (1.0 - i.albedo)
        albedo = np.divide(scattering, rate, out=np.zeros_like(rate), where=rate > 0)
        return replace(i, rate=rate, albedo=albedo, phases=tuple(p for p, _ in made))

    return _with_parts(stack, layers, lambda parts: tuple(turned(i) if plain_scatterer(i) else i for i in parts))


def _with_parts(
    stack: OpticalStack, layers: Names, change: Callable[[tuple[Interaction, ...]], tuple[Interaction, ...]]
) -> OpticalStack:
    made = tuple(replace(x, interactions=change(x.interactions)) if x.name in layers else x for x in stack.layers)
    return replace(stack, layers=made)
