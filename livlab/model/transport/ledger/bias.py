"""What interpolation between a ledger's anchors costs, without chance: the same sums with adding–doubling."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from livlab.model.tissue.stack import REDIRECT_MEAN, Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.ledger.data import Anchors, Coefficients
from livlab.model.transport.ledger.plan import blend, levels, similar
from livlab.model.transport.source import Source
from livlab.units import FloatArray

NODES = 8
ORDER = 128
"""Coarse: both sides of the difference are solved alike."""


def interpolation_bias(
    stack: OpticalStack,
    anchors: Anchors,
    rows: tuple[int, ...],
    degree: int,
    bear: FloatArray,
    scaled: bool,
    source: Source,
    at: list[int] | None = None,
) -> FloatArray:
    """Σ c_a R_a − R of the total reflectance, R_a the reflectance with an anchor's phase functions and indices.

    Places and sides are left out, and short free paths count as `adding_doubling` takes them.

    Parameters
    ----------
    stack
        Sorted by wavelength.
    anchors, rows, degree, bear, scaled
        Of the ledger; `rows` are the anchors' places among the stack's wavelengths.
    source
        The light.
    at
        Wavelengths by place; default: half-way between neighbouring anchors, the ends if there is one anchor;
        those whose optics are the anchor's own are left out.
    """
    if at is None:
        at = [(a + b) // 2 for a, b in pairwise(rows)] or [0, len(stack.wavelength_nm) - 1]
        at = [k for k in at if not all(_alike(stack, k, row) for row in rows)]
    at = [k for k in at if k not in rows]
    if not at:
        return np.zeros(0)
    sets = Coefficients.of(stack).take(at)
    c = blend(sets.wavelength_nm, anchors.wavelength_nm, degree)
    level = levels(anchors, c, bear)
    factors = [similar(sets, anchors, k, level[k], scaled) for k in range(len(anchors))]
    found = np.zeros(len(at))
    for i, place in enumerate(at):
        own = stack.at([place])
        found[i] = -_solve(own, own, sets.absorption[i], sets.scattering[i], source)
        for k, row in enumerate(rows):
            if c[i, k] != 0.0:
                scattering = sets.scattering[i] * factors[k][i]
                value = _solve(stack.at([row]), own, sets.absorption[i], scattering, source)
                found[i] += c[i, k] * value
    return found


def _alike(stack: OpticalStack, a: int, b: int) -> bool:
    """Whether indices are equal at two wavelengths, and each layer scatters by one and the same phase function."""
    same = [stack.n_above[a] == stack.n_above[b], stack.n_below[a] == stack.n_below[b]]
    for layer in stack.layers:
        met = {i.phases[k] for i in layer.interactions for k in (a, b) if i.rate[k] * i.albedo[k] > 0}
        same += [layer.n[a] == layer.n[b], len(met) <= 1]
    return all(same)


def _solve(
    optics: OpticalStack, own: OpticalStack, absorption: FloatArray, scattering: FloatArray, source: Source
) -> float:
    """Reflectance over what enters, times what enters at the setting's own surface."""
    layers = []
    for k, layer in enumerate(optics.layers):
        parts = []
        total = float(layer.scattering[0])
        for i in layer.interactions:
            rate = i.rate * i.albedo * REDIRECT_MEAN[i.redirect]
            if rate[0] > 0:
                change = float(scattering[k]) / total
                parts.append(Interaction(i.name, rate * change, np.ones(1), i.phases, "none", i.absorb_below_mm))
        if layer.interactions:
            phase = parts[0].phases if parts else layer.interactions[0].phases
            parts.append(Interaction("absorber", np.full(1, absorption[k]), np.zeros(1), phase))
        layers.append(PlaneLayer(layer.name, layer.thickness_mm, layer.n, tuple(parts)))
    made = OpticalStack(optics.wavelength_nm, tuple(layers), optics.n_above, optics.n_below)
    mu0 = float(np.cos(source.angle_rad)) if source.kind == "collimated" else 1.0
    found = adding_doubling(made, mu0=mu0, nodes=NODES, order=ORDER)
    if source.kind == "collimated":
        mirrored = float(found.specular[0])
        value = float(found.reflectance[0])
    else:
        from livlab.model.transport.fresnel import diffuse_fresnel

        mirrored = diffuse_fresnel(float(made.n_above[0]), float(made.layers[0].n[0]))
        value = float(found.reflectance_diffuse_incidence[0]) - mirrored
    return value / (1.0 - mirrored) * _enters(own, source)


def _enters(own: OpticalStack, source: Source) -> float:
    from livlab.model.transport.ledger.plan import specular

    return float(1.0 - specular(Coefficients.of(own).index, source)[0])
