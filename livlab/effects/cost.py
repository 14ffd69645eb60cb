"""What a walk over a scene costs, before it is walked: expected collisions and crossings, and what each step takes.

With a trace ε of absorption added to a layer, the share of light that ε absorbs over ε is the mean path of the light
in that layer; times the layer's summed rate it is the mean number of collisions a photon has there (adding–doubling at
few nodes). That counts photons of the literal walk, which end where they are absorbed; those of the weighted walk go
on until half their weight is left, so their number is larger, by a factor that differs little between like scenes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from livlab.effects.reduce import more_absorbing
from livlab.effects.scene import OpticalScene
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.moments import Moments, layer_optics

if TYPE_CHECKING:
    from livlab.units import FloatArray

TRACE = 1e-6
MOST_STEPS = 1e5

START = 3.0
"""Steps that the beginning and the end of a photon are worth."""
PER_LAYER = 0.1
IN_SPACE = 0.45
BY_TABLE = 0.15
PER_WAY = 0.25
"""Added cost of a step in units of the plainest (one endless layer, a closed-form phase function; 6.6 ns of one core
of the machine that timed them): for each further layer, for places and directions in space, for a tabulated phase
function, and for each further way of scattering (in the literal walk: each further element)."""


def mean_steps(stack: OpticalStack, mu0: float) -> FloatArray:
    """(W,) mean number of collisions and crossings of a photon that enters the stack, about.

    Examples
    --------
    >>> from livlab.model.tissue.phase.functions import Isotropic
    >>> from livlab.model.tissue.stack import plain_stack
    >>> slab = plain_stack([(1.0, 1.0, 0.0, float("inf"), Isotropic())])
    >>> float(mean_steps(slab, 1.0)[0].round(3))
    1.0
    """
    width = len(stack.wavelength_nm)
    solved = adding_doubling(more_absorbing(stack, np.full(width, TRACE)), mu0=mu0, nodes=6, tolerance=1e-4, order=64)
    absorbed = solved["absorbed"].to_numpy()
    entered = 1.0 - solved["specular"].to_numpy()
    known = Moments(1, 1e-3)
    steps = np.zeros(width)
    for j, x in enumerate(stack.layers):
        rate = np.sum([i.rate for i in x.interactions], axis=0) if x.interactions else np.zeros(width)
        own = np.array([layer_optics(x, k, float(x.n[k]), known).absorption for k in range(width)])
        path = absorbed[:, j] / (own + TRACE)
        # Light in all directions alike crosses a plane half as often as it passes a layer of its path's length.
        steps = steps + path * rate + (0.0 if math.isinf(x.thickness_mm) else 0.5 * path / x.thickness_mm)
    return np.asarray(np.minimum(steps / np.maximum(entered, TRACE), MOST_STEPS))


def predicted_cost(scene: OpticalScene, *, literal: bool = False) -> float:
    """Cost of a photon, mean over the wavelengths, in plain steps.

    Parameters
    ----------
    scene
        Stack and instrument.
    literal
        For the literal walk, in which every element draws, in place of the weighted one.
    """
    view = scene.instrument.readout(scene.stack.n_above)
    binned = bool(view.tally.radius_edges)
    step = (
        1.0
        + PER_LAYER * (len(scene.stack.layers) - 1)
        + IN_SPACE * (view.half_width_mm is not None or binned)
        + BY_TABLE * any(_tabulated(x, literal) for x in scene.stack.layers)
        + PER_WAY * max(0, max(_ways(x, literal) for x in scene.stack.layers) - 1)
    )
    return float(np.mean(START + step * mean_steps(scene.stack, math.cos(view.source.angle_rad))))


def _scatterers(layer: PlaneLayer) -> list[Interaction]:
    return [i for i in layer.interactions if (i.rate * i.albedo).any()]


def _tabulated(layer: PlaneLayer, literal: bool) -> bool:
    """Whether a step looks its angle up; the weighted walk mixes the layer's phase functions into one."""
    parts = _scatterers(layer)
    phases = {id(i.phases[0]): i.phases[0] for i in parts}
    if any(not isinstance(p, Isotropic | Rayleigh | HenyeyGreenstein) for p in phases.values()):
        return True
    return not literal and any(p != next(iter(phases.values())) for p in phases.values())


def _ways(layer: PlaneLayer, literal: bool) -> int:
    if literal:
        return sum(bool(i.rate.any()) for i in layer.interactions)
    return len({(i.redirect, i.absorb_below_mm) for i in _scatterers(layer)})
