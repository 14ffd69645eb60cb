"""How much light a sample's sides or a port's rim can take from a reading: upper bounds, for any stack.

What a finite sample reads lies below what an endless one reads by the light of those paths that pass the edge. Three
bounds of it hold at once, and the least counts. With L a path's length, w its weight and d the way to the edge:

- an evenly lit square of half side h: a path leaves it for the share (range in x + range in y)/2h of its entry
  points at most, a range is at most ∫|Ω_x| dl, and over azimuths that is (2/π) ∫ sin θ dl: so 2 E[w L]/(π h);
- a narrower beam: a path that comes to the edge has L ≥ d, so E[w L]/d;
- a function e^{sx} ψ(Ω_x) > 0 on which transport acts as a loss, (Ω·∇ − µ_t + µ_s K) e^{sx} ψ ≤ 0, can only fall along
  a walk (a supermartingale): the chance to come to a plane at distance d is at most e^{−sd} ψ(at entry)/min ψ
  (outwards). A reflection at a layer's surface keeps Ω_x. One layer: ψ solves the equation with a positive source,
  which exists up to the decay rate of diffuse light. Several layers: ψ = 1 + β n Ω_x, which refraction keeps.

E[w L] = −∂V/∂µ_a, the reading's own derivative, by adding–doubling.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from livlab.acquire.instruments.base import Edge
from livlab.effects.plane import PlaneValue, plane_value
from livlab.effects.reduce import more_absorbing
from livlab.effects.scene import OpticalScene
from livlab.model.tissue.stack import OpticalStack, PlaneLayer
from livlab.model.transport.fresnel import fresnel
from livlab.model.transport.geometry import Readout
from livlab.units import FloatArray

_DIRECTIONS = 48
_SPACING = 3.2 / _DIRECTIONS
_RATES = np.linspace(0.05, 1.0, 39)


def missed(scene: OpticalScene, value: PlaneValue, enough: float = 0.0) -> FloatArray:
    """(W,) upper bound of what the reading loses sideways; 0 for endless samples.

    Parameters
    ----------
    scene
        Stack and instrument.
    value
        Its reading as if endless.
    enough
        A bound as low as this needs no lowering.
    """
    edges = scene.instrument.edges()
    if not edges:
        return np.zeros_like(value.fine)
    least = np.maximum(value.scattered, 0.0)
    known = [e for e in edges if e.distance_mm > 0]
    if not known:
        return least
    view = scene.instrument.readout(scene.stack.n_above)
    for edge in known:
        if not edge.lit_all_over and edge.plane_mm > 0:
            least = np.minimum(least, [_reached(scene.stack, k, view, edge) for k in range(len(least))])
    if np.max(least) > enough:
        share = 2.0 / math.pi if known[0].lit_all_over else 1.0
        distance = known[0].distance_mm
        least = np.minimum(least, share * _weighted_length(scene, value, distance) / distance)
    return np.asarray(least)


def _weighted_length(scene: OpticalScene, value: PlaneValue, distance_mm: float) -> FloatArray:
    """E[w L] in mm from above: the derivative by two steps, with what the steps and the solver leave open."""
    step = 0.02 / distance_mm
    slopes, errors = [], []
    for h in (step, step / 2):
        more = plane_value(more_absorbing(scene.stack, np.full_like(value.fine, h)), scene.instrument)
        fine, coarse = (value.fine - more.fine) / h, (value.coarse - more.coarse) / h
        slopes.append(fine)
        errors.append(np.abs(fine - coarse))
    return np.asarray(2 * slopes[1] - slopes[0] + np.abs(slopes[1] - slopes[0]) + 2 * errors[1] + errors[0])


def _reached(stack: OpticalStack, index: int, view: Readout, edge: Edge) -> float:
    """Bound by e^{sx} ψ at one wavelength."""
    n_above, n = float(stack.n_above[index]), float(stack.layers[0].n[index])
    sine = min(1.0, n_above * math.sin(view.source.angle_rad) / n)
    media = [_Medium.of(x, index) for x in stack.layers]
    rates = _one_layer(media[0], sine) if len(media) == 1 else _layers(media, sine)
    if not rates:
        return math.inf
    least = min(factor * math.exp(-s * edge.plane_mm) for s, factor in rates)
    entered = 1.0 - float(fresnel(n_above, n, math.cos(view.source.angle_rad)))
    return float(view.weights.max()) * entered * edge.sides * least


@dataclass(frozen=True)
class _Medium:
    """A layer's index, absorption and scattering in 1/mm, and moments; a redirect factor counts as 1, from above."""

    n: float
    absorption: float
    scattering: float
    moments: FloatArray

    @classmethod
    def of(cls, layer: PlaneLayer, k: int) -> _Medium:
        parts = [(float(i.rate[k] * i.albedo[k]), i.phases[k]) for i in layer.interactions]
        parts = [(s, p) for s, p in parts if s > 0]
        scattering = math.fsum(s for s, _ in parts)
        absorption = math.fsum(float(i.rate[k] * (1.0 - i.albedo[k])) for i in layer.interactions)
        if not parts:
            return cls(float(layer.n[k]), absorption, 0.0, np.eye(1, _DIRECTIONS + 1)[0])
        chi = np.sum([s / scattering * p.legendre(_DIRECTIONS) for s, p in parts], axis=0)
        return cls(float(layer.n[k]), absorption, scattering, np.asarray(chi))


def _one_layer(m: _Medium, sine: float) -> list[tuple[float, float]]:
    """(s, ψ(entry)/min ψ(outwards)) for rates s at which a positive ψ exists."""
    x, w = np.polynomial.legendre.leggauss(_DIRECTIONS)
    peak = max(float(m.moments[-1]), 0.0)  # what is narrower than the directions goes straight on (delta-M)
    chi = (m.moments[:-1] - peak) / (1.0 - peak)
    scattering = m.scattering * (1.0 - peak)
    extinction = m.absorption + scattering
    table = np.polynomial.legendre.legvander(x, _DIRECTIONS - 1)
    kernel = (table * ((np.arange(_DIRECTIONS) + 0.5) * chi)) @ (table.T * w)
    transport = m.absorption + m.scattering * (1.0 - float(m.moments[1]) if m.scattering > 0 else 1.0)
    fastest = min(1.2 * math.sqrt(3.0 * m.absorption * transport), m.absorption + transport, 0.999 * extinction)
    found = []
    for s in _RATES * fastest if fastest > 0.0 else ():
        psi = np.linalg.solve(np.diag(extinction - s * x) - scattering * kernel, np.ones_like(x))
        if not (np.isfinite(psi).all() and (psi > 0).all()):
            break
        # One node beyond, on the safe side.
        entry, outwards = np.abs(x) <= sine + _SPACING, x >= -_SPACING
        found.append((float(s), float(psi[entry].max() / psi[outwards].min())))
    return found


def _layers(media: list[_Medium], sine: float) -> list[tuple[float, float]]:
    """The same with ψ = 1 + β n Ω_x, for rates at which one β serves every layer."""
    transport = [m.absorption + m.scattering * (1.0 - float(m.moments[1])) for m in media]
    fastest = min(math.sqrt(m.absorption * t) for m, t in zip(media, transport, strict=True))
    found = []
    for s in _RATES * fastest:
        if s <= 0.0:
            break
        low, high = 0.0, 1.0 / max(m.n for m in media)
        for m, t in zip(media, transport, strict=True):
            if s > m.absorption:
                low = max(low, (s - m.absorption) / (m.n * (t - s)) if t > s else math.inf)
            high = min(high, (m.absorption + s) / (m.n * (t + s)))
        if low <= high and low * max(m.n for m in media) < 1.0:
            found.append((float(s), 1.0 + low * media[0].n * sine))
    return found
