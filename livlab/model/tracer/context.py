"""What the parts of the tracer's loop share: the scene made ready, the options, random numbers, steps and rounding.

What a scene lacks leaves no code in the kernel: the flags here tell, while the loop is traced, what there is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from livlab.model.tracer.flight import Flight, Flights
from livlab.model.tracer.lights import Lights
from livlab.model.tracer.medium import Medium
from livlab.model.tracer.state import PathState
from livlab.model.tracer.surface import Hit, Surface, other_shapes
from livlab.model.transport import rng as random
from livlab.model.transport.device import Device

CREEP = 5e-7
"""Step, as part of the coordinates, past a hit that cannot be one: the surface that a ray has just left. A float knows
coordinates to 6e-8 of themselves."""

MAX_BOUNCES = 1000
"""Objects that a path may hit. Of the light of a closed room that reflects 0.99 all but 5e-5 comes with fewer."""

GRAZING = 1e-3
"""Least cosine with the surface that such a step is lengthened for."""


@dataclass(frozen=True)
class TracerOptions:
    """How paths are followed.

    Attributes
    ----------
    estimator
        "expected" or "analog".
    max_steps, max_bounces
        Steps, and objects hit, after which a path is given up.
    camera_within
        Whether the camera may stand inside the body.
    next_event
        Whether scatterings inside the body sample the lamps; if not, lamps are only hit by chance.
    """

    estimator: str = "expected"
    max_steps: int = 100_000
    max_bounces: int = MAX_BOUNCES
    camera_within: bool = True
    next_event: bool = True


class Context:
    """A scene made ready, as every part of the loop sees it.

    Attributes
    ----------
    medium, flights
        The tissue and its free flights; None: a scene without.
    lights
        The scene's sources.
    camera
        From a random stream and a row of the film to a ray's origin and direction.
    surface, interfaces
        The body's surfaces, and their number.
    others
        Shapes that are no body's.
    size
        Of the body, in units of the scene.
    fence
        Tells of a place inside whether a path ends there; None: nowhere.
    width, padded
        Number of wavelengths, and the length of a row of the film.
    next_event
        Whether scatterings sample lamps.
    analog, forces, short, field
        Whether absorption ends paths; is survived by weight once; has a least free path; whether a distance field tells
        the depth.
    """

    def __init__(
        self,
        d: Device,
        mi: Any,
        scene: Any,
        *,
        shapes: Sequence[Any],
        medium: Medium | None,
        flights: Flights | None,
        lights: Lights,
        camera: Callable[[Any, Any], tuple[Any, Any]],
        size: float,
        options: TracerOptions,
    ) -> None:
        self.d, self.mi, self.dr, self.scene = d, mi, d.dr, scene
        self.medium, self.flights, self.lights = medium, flights, lights
        self.camera, self.size, self.options = camera, size, options
        self.surface, self.interfaces = Surface(d, mi, scene, shapes), len(shapes)
        self.others = other_shapes(d, mi, scene, shapes)
        self.fence: Callable[[Any], Any] | None = None
        self.max_steps = d.dr.opaque(mi.UInt32, options.max_steps)
        self.max_bounces = d.dr.opaque(mi.UInt32, options.max_bounces)
        self.least = d.dr.opaque(mi.Float, 0.01 * CREEP * size)
        self.width, self.padded = len(lights.wavelengths), lights.padded
        self.next_event = options.next_event and medium is not None and bool(lights.lamps)
        self.analog = options.estimator == "analog"
        self.forces = medium is not None and medium.lossy and not self.analog
        self.short = medium is not None and medium.short
        self.field = flights is not None and flights.field is not None

    def uniform(self, s: PathState) -> Any:
        """The lanes' next random numbers in [0, 1)."""
        return random.uniform(self.d, s.stream.next_uint32())

    def record_step(self, s: PathState, flight: Flight, path: Any) -> None:
        """Add a step to the path's sums."""
        assert self.flights is not None and self.medium is not None
        s.covered = s.covered - path
        if self.medium.several:
            parts = self.flights.lengths(flight, path)
            s.throughput.lengths = [x + y for x, y in zip(s.throughput.lengths, parts, strict=True)]

    def nudge(self, p: Any) -> Any:
        """More than a point can be off by rounding."""
        dr = self.dr
        return dr.fma(dr.maximum(dr.maximum(dr.abs(p.x), dr.abs(p.y)), dr.abs(p.z)), CREEP, self.least)

    def creep(self, p: Any, hit: Hit) -> Any:
        """How far to go on from a hit that cannot be one: until rounding cannot have it in the way again."""
        dr = self.dr
        return self.nudge(p) * dr.rcp(dr.maximum(dr.abs(dr.dot(hit.facet, hit.ray.d)), GRAZING))

    def leaves(self, s: PathState, hit: Hit) -> Any:
        """Whether a hit from inside is of an interface of the path's own region, from the right side."""
        if self.interfaces == 1:
            return ~hit.outward
        region = s.medium - 1
        return ((hit.interface == region) & ~hit.outward) | ((hit.interface == region + 1) & hit.outward)
