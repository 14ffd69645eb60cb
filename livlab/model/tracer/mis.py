"""MIS weights of a lamp's light: how it is divided between next-event estimation and hitting the lamp by chance.

Light that a collision samples from a lamp of solid angle ω weighs ω p, p being the phase function towards it: without
bound where that is sharp. A lamp that a scattered path hits weighs 1, but a wide phase function seldom hits it. The
weights are 1 / (1 + ω p) and ω p / (1 + ω p), near the balance heuristic (Veach 1997, eq. 9.8): no light then weighs
more than the lamp's radiance. They add to 1 whatever ω is, so a rough one does; p is one wavelength's for all, lest
they hang on which one leads the path.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from livlab.model.tracer.context import Context
from livlab.model.tracer.lights import LampWeight
from livlab.model.tracer.state import Collision, PathState


class MisWeights:
    """Weights of the lamps that have an extent; a point or a parallel beam is never hit by chance.

    Attributes
    ----------
    needed
        Whether there is such a lamp.
    """

    def __init__(self, context: Context) -> None:
        self.context, self.dr, self.mi = context, context.dr, context.mi
        lights, one = context.lights, context.dr.opaque
        self.needed = bool(lights.surfaces)
        found = [self._solid_angle(e) if e in lights.surfaces else 0.0 for e in lights.all]
        self.of_light = context.d.load(self.mi.Float, found)
        self.of_lamp = [one(self.mi.Float, found[lights.all.index(e)]) for e in lights.lamps]
        self.wavelength = one(self.mi.UInt32, context.width // 2)

    def _solid_angle(self, lamp: Any) -> float:
        """Solid angle inside that a lamp fills, times the number of lamps of which one is sampled; roughly."""
        shape, box = lamp.get_shape(), self.context.surface.shapes[0].bbox()
        apart = np.array(shape.bbox().center()).ravel() - np.array(box.center()).ravel()
        near = 0.5 * float(max(box.extents()))
        area = float(np.array(shape.surface_area()).ravel()[0])
        # Refraction narrows a solid angle to about half; a lamp around the body fills half of all directions.
        return 0.5 * len(self.context.lights.lamps) * area / max(float(apart @ apart), near**2, area / 6.28)

    def pdf(self, collision: Collision, w: Any, active: Any) -> Any:
        """Density in 1/sr with which a collision scatters a path by w = 1 − cos θ."""
        assert self.context.medium is not None
        return self.context.medium.phase_function(collision, self.wavelength, active)(w)

    def of_sampled(self, s: PathState, w: Any, active: Any) -> Any:
        """MIS weight of light that a collision samples from its lamp."""
        assert self.context.medium is not None
        solid_angle = self.context.medium.pick(s.lamp.number, self.of_lamp)
        return self.dr.rcp(1.0 + solid_angle * self.pdf(s.collision, w, active))

    def of_hit(self, s: PathState) -> LampWeight:
        """MIS weight of a lamp that a path hits, by the lamp's number; 1 where it could not have been sampled."""
        dr, mi = self.dr, self.mi

        def weight(number: Any) -> Any:
            sampled = s.covered > 0.0
            ratio = s.collision.pdf * dr.gather(mi.Float, self.of_light, number, sampled)
            return dr.select(sampled, ratio * dr.rcp(1.0 + ratio), 1.0)

        return weight
