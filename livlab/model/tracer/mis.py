"""How a lamp's light is shared between asking for it at a meeting and meeting it by chance after it.

Asked for, light that arrives from a lamp of solid angle ω weighs ω p, p being the phase function towards it: without
bound where that is sharp. Met by chance it weighs 1, but a wide phase function seldom meets it. Each way counts its
share, 1 / (1 + ω p) and ω p / (1 + ω p), near the balance heuristic (Veach 1997, eq. 9.8): no light then weighs more
than the lamp's radiance. The shares add to 1 whatever ω is, so a rough one does; p is one wavelength's for all, lest
they hang on which one leads the path.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from livlab.model.tracer.context import Context
from livlab.model.tracer.state import Meeting, State


class Shares:
    """Shares of the lamps that have an extent; a point or a parallel beam is never met by chance.

    Attributes
    ----------
    needed
        Whether there is such a lamp.
    """

    def __init__(self, context: Context) -> None:
        self.context, self.dr, self.mi = context, context.dr, context.mi
        lights, one = context.lights, context.dr.opaque
        self.needed = bool(lights.surfaces)
        found = [self._extent(e) if e in lights.surfaces else 0.0 for e in lights.all]
        self.of_light = context.d.load(self.mi.Float, found)
        self.of_lamp = [one(self.mi.Float, found[lights.all.index(e)]) for e in lights.lamps]
        self.leader = one(self.mi.UInt32, context.width // 2)

    def _extent(self, lamp: Any) -> float:
        """Solid angle inside that a lamp fills, times the number of lamps of which one is asked for; roughly."""
        shape, box = lamp.get_shape(), self.context.surface.shapes[0].bbox()
        way = np.array(shape.bbox().center()).ravel() - np.array(box.center()).ravel()
        near = 0.5 * float(max(box.extents()))
        area = float(np.array(shape.surface_area()).ravel()[0])
        # Refraction narrows a solid angle to about half; a lamp around the body fills half of all directions.
        return 0.5 * len(self.context.lights.lamps) * area / max(float(way @ way), near**2, area / 6.28)

    def density(self, now: Meeting, w: Any, active: Any) -> Any:
        """Density in 1/sr with which a meeting turns a path by w = 1 − cos θ."""
        m = self.context.medium
        assert m is not None
        return m.phase(now.layer, self.leader, now.code, now.g, now.base, active)(w)

    def asked(self, s: State, w: Any, active: Any) -> Any:
        """Share of a lamp's light that counts where it is asked for."""
        assert self.context.medium is not None
        extent = self.context.medium.pick(s.aim.lamp, self.of_lamp)
        return self.dr.rcp(1.0 + extent * self.density(s.meeting, w, active))

    def met(self, s: State) -> Callable[[Any], Any]:
        """Share that counts where a path meets a lamp, by the lamp's number; all where it was not asked for."""
        dr, mi = self.dr, self.mi

        def share(number: Any) -> Any:
            asked = s.covered > 0.0
            weight = s.meeting.turned * dr.gather(mi.Float, self.of_light, number, asked)
            return dr.select(asked, weight * dr.rcp(1.0 + weight), 1.0)

        return share
