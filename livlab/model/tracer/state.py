"""What a lane carries from step to step; () or an empty list stands for what a scene does not need."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

WALK, COLLIDE, SCATTER, INTERFACE, CAST, LOST, NEXT_EVENT, OUTSIDE, END = range(9)
"""What a lane is to do next: fly on inside; decide what a collision is; be scattered by it; cross an interface told by
depth; see whether the surface is in the way of its flight; leave, as it finds itself outside; sample a lamp from its
collision; follow a ray outside; begin its next path."""

LAST_INTERIOR = INTERFACE
"""All up to this one are the interior walk's; the others cast rays or weigh light."""


@dataclass
class Throughput:
    """Running sums of a path's contributions, from which its weight at every wavelength follows.

    Attributes
    ----------
    common
        Weight that is the same for all wavelengths.
    lengths
        Path in each layer.
    counts
        Scatterings in each layer that scatters alike at all wavelengths.
    rows
        Σ ln density of all that differs from wavelength to wavelength otherwise, a value a wavelength.
    forced
        Layer in which the path was made to survive, the number of layers for none.
    first
        Row of Fresnel's table that the first surface was hit with, where it differs by wavelength.
    carried
        Product of the reflectances of other objects hit, a value a wavelength.
    """

    common: Any
    lengths: list[Any] = field(default_factory=list)
    counts: list[Any] = field(default_factory=list)
    rows: list[Any] = field(default_factory=list)
    forced: Any = ()
    first: Any = ()
    carried: list[Any] = field(default_factory=list)


@dataclass
class Place:
    """Where a path is with respect to the surface of its body.

    Attributes
    ----------
    depth, inward
        Depth below the surface and the direction in which it grows, both as if the surface were flat.
    trust
        Path for which that holds.
    clear
        Path within which no point of the surface can be.
    since
        Path since the last free path was drawn.
    """

    depth: Any = ()
    inward: Any = ()
    trust: Any = ()
    clear: Any = ()
    since: Any = ()


@dataclass
class Collision:
    """The collision that a path has come to, until it is scattered or absorbed.

    Attributes
    ----------
    layer, within
        Its layer, and the path in it since the last free path was drawn.
    code, g, base
        How what was hit scatters: see `livlab.model.tracer.medium.Medium`.
    probability
        With which a lamp was sampled from it.
    pdf
        Density in 1/sr with which the path was last scattered: see `livlab.model.tracer.mis`.
    """

    layer: Any = ()
    within: Any = ()
    code: Any = ()
    g: Any = ()
    base: Any = ()
    probability: Any = ()
    pdf: Any = ()


@dataclass
class LampSample:
    """The lamp that a path's collisions sample: which one, the sample of its surface, and where that lies.

    Attributes
    ----------
    number
        Of the lamp.
    sample
        Two random numbers, for the place on its surface.
    spot
        The place, or the direction to a distant lamp.
    distant
        Whether it is one.
    """

    number: Any = ()
    sample: Any = ()
    spot: Any = ()
    distant: Any = ()


@dataclass
class Bounce:
    """What a light hit next needs to know of the last object.

    Attributes
    ----------
    p, pdf
        Where the ray was sent off, and with what density of direction; 0 where lights count fully.
    count
        Objects hit.
    """

    p: Any
    pdf: Any
    count: Any


@dataclass
class PathState:
    """A lane: its random numbers, its place in the picture, and the path it follows.

    Attributes
    ----------
    row, sample
        Row of the film, and which of the row's samples.
    hero
        Wavelength that the path is drawn with.
    medium
        0 outside, else the region of the tissue plus one.
    pending
        What it is to do next.
    tau
        Optical depth of the flight that waits for a ray cast.
    fresh
        The path is still the camera's own ray.
    covered
        Path on which a lamp may also have been sampled at the last scattering, less what was gone since: while it is
        positive, a lamp that is hit counts with its MIS weight.
    light
        What the row has seen, a value a wavelength.
    bounce
        The last object; () in a scene without.
    strayed
        How often a path of the lane found itself outside; it goes on from there, as if it had been seen to leave.
    """

    stream: Any
    row: Any
    sample: Any
    hero: Any
    medium: Any
    pending: Any
    tau: Any
    p: Any
    d: Any
    place: Place
    collision: Collision
    lamp: LampSample
    throughput: Throughput
    fresh: Any
    covered: Any
    bounce: Any
    light: list[Any]
    steps: Any
    strayed: Any
