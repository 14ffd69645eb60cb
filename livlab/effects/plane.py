"""What an instrument reads over an endless stack, by adding–doubling at two node counts, and its own error."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from livlab.acquire.instruments.base import VirtualInstrument
from livlab.effects.scene import OpticalScene
from livlab.model.tissue.phase.functions import Isotropic
from livlab.model.tissue.stack import OpticalStack
from livlab.model.transport.adding_doubling import adding_doubling, exit_flux
from livlab.units import FloatArray

NODES = (12, 18)
"""Nodes per interval of the two solutions; errors fall with at least the fourth power, so between them by 5."""

ORDER = 256
"""Legendre moments kept; a sharper peak counts as unscattered, which moves readings by 1e-7 of themselves (delta-M)."""

NEGLECTED = 1e-6
"""Share of a reading that moments left out of the phase functions, here and below 1e-6, may move."""

ANGLES_DEG = (0.0, 20.0, 40.0, 60.0, 80.0)
"""Angles of light and of eye at which what a picture's plan leaves out is worked out once more: a picture has them all,
its plan's instrument one light at 45° and an eye on the normal."""

_TOLERANCE = 1e-5


@dataclass(frozen=True)
class PlaneValue:
    """(W,) readings of an endless sample.

    Attributes
    ----------
    coarse, fine
        The reading at both node counts.
    scattered
        The finer one without the surface's mirror reflection.
    """

    coarse: FloatArray
    fine: FloatArray
    scattered: FloatArray

    def difference(self, other: PlaneValue) -> FloatArray:
        """(W,) how far the readings lie apart, and how uncertain the solver leaves that."""
        fine = self.fine - other.fine
        # Errors that both share cancel here; four times what the order of convergence leaves of the rest.
        open_ = np.abs(fine - (self.coarse - other.coarse)) + NEGLECTED * np.maximum(self.fine, other.fine)
        return np.asarray(np.abs(fine) + open_)


def plane_value(stack: OpticalStack, instrument: VirtualInstrument) -> PlaneValue:
    """The instrument's reading over the stack as if neither sample nor port ended sideways.

    Raises
    ------
    InputError
        For an instrument whose reading hangs on a lateral distance, as a fibre probe's does.
    """
    view = instrument.readout(stack.n_above)
    mu0 = math.cos(view.source.angle_rad)
    solved = [adding_doubling(stack, mu0=mu0, nodes=n, tolerance=_TOLERANCE, order=ORDER) for n in NODES]
    coarse, fine = (view.of_endless(x) for x in solved)
    return PlaneValue(coarse, fine, replace(view, specular_weight=0.0).of_endless(solved[1]))


def widest_change(full: OpticalStack, reduced: OpticalStack) -> float:
    """Largest change of πL/E over wavelengths and `ANGLES_DEG` of light and eye, by adding–doubling, mean over azimuth.

    >>> from livlab.model.tissue.stack import plain_stack
    >>> some, more = (plain_stack([(1.0, a, 1.0, np.inf, Isotropic())]) for a in (1.0, 1.1))
    >>> 0.0 < widest_change(some, more) < 0.05
    True
    """
    cosines = np.cos(np.radians(ANGLES_DEG))
    worst = 0.0
    for mu0 in cosines:
        # Errors of the solver that both share cancel in the difference.
        first, second = (
            exit_flux(adding_doubling(s, mu0=float(mu0), nodes=NODES[-1], tolerance=_TOLERANCE, order=ORDER), cosines)
            for s in (full, reduced)
        )
        worst = max(worst, float(np.abs(np.pi * (first - second) / cosines).max()))
    return worst


def unseen(scene: OpticalScene) -> str:
    """Why adding–doubling cannot tell what an effect of the scene changes; empty if it can."""
    if scene.instrument.lateral_distance:
        return f"the deterministic solver knows no {scene.instrument.lateral_distance}"
    for x in scene.stack.layers:
        for i in x.interactions:
            scatters = np.flatnonzero(i.rate * i.albedo)
            if i.redirect != "none" and any(not isinstance(i.phases[k], Isotropic) for k in scatters):
                return "the deterministic solver knows no redirect factor on a phase function"
    return ""


def without_short_paths(stack: OpticalStack) -> OpticalStack | None:
    """The stack without absorption by short free paths; None if it has none."""
    if not any(i.absorb_below_mm > 0 for x in stack.layers for i in x.interactions):
        return None
    layers = tuple(
        replace(x, interactions=tuple(replace(i, absorb_below_mm=0.0) for i in x.interactions)) for x in stack.layers
    )
    return replace(stack, layers=layers)
