"""What a lane carries from step to step; () stands for what a scene does not need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

WALK, MET, TURN, BARRIER, CAST, LOST, ASK, OUT, END = range(9)
"""What a lane is to do next: fly on inside; meet what it came to; be turned there; cross an interface told by depth;
see whether the surface is in the way of its flight; leave, as it finds itself outside; ask for a lamp; follow a ray
outside; turn to its next path. The first four are the stroll's, all others cast rays or weigh light."""

QUIET = BARRIER


@dataclass
class Ledger:
    """What a path did, as far as its density at other wavelengths depends on it.

    Attributes
    ----------
    lengths
        Path in each layer.
    counts
        Meetings in each layer that scatters alike at all wavelengths.
    rows
        Σ ln density of all that differs from wavelength to wavelength otherwise, a value a wavelength.
    forced
        Layer in which the path was made to survive, the number of layers for none.
    first
        Row of Fresnel's table that the first surface was met with, where it differs by wavelength.
    common
        Weight that is the same for all wavelengths.
    carried
        Reflectance of other objects met, a value a wavelength.
    """

    lengths: Any
    counts: Any
    rows: Any
    forced: Any
    first: Any
    common: Any
    carried: Any


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
        Path from the last draw.
    """

    depth: Any
    inward: Any
    trust: Any
    clear: Any
    since: Any


@dataclass
class Meeting:
    """A meeting that is not over yet.

    Attributes
    ----------
    layer, within
        Its layer, and the path in it since the last draw.
    code, g, base
        How what was met scatters: see `livlab.model.tracer.medium.Medium`.
    chance
        With which the lamp was asked for.
    turned
        Density with which the path was last turned: see `livlab.model.tracer.mis`.
    """

    layer: Any
    within: Any
    code: Any
    g: Any
    base: Any
    chance: Any
    turned: Any


@dataclass
class Aim:
    """The lamp that a path's meetings ask: which one, the sample of its surface, and where that lies.

    Attributes
    ----------
    spot
        Place of the sample, or the direction to a distant lamp.
    """

    lamp: Any
    sample: Any
    spot: Any
    distant: Any


@dataclass
class State:
    """A lane: its random numbers, its place in the picture, and the path it follows.

    Attributes
    ----------
    row, turn
        Row of the film, and which of the row's samples.
    medium
        0 outside, else the region of the tissue plus one.
    pending
        What it is to do next.
    tau
        Optical depth of the flight that waits for a ray cast.
    fresh
        The path is still the camera's own ray.
    covered
        Path on which lamps were asked for at the last scattering, less what was gone since: a lamp that is met while it
        is positive was counted in part.
    light
        What the row has seen, a value a wavelength.
    bounce
        What the next light met needs to know of the last object: see `livlab.model.tracer.objects`.
    """

    stream: Any
    row: Any
    turn: Any
    hero: Any
    medium: Any
    pending: Any
    tau: Any
    p: Any
    d: Any
    place: Place
    meeting: Meeting
    aim: Aim
    ledger: Ledger
    fresh: Any
    covered: Any
    bounce: Any
    light: Any
    steps: Any
    troubles: Any
