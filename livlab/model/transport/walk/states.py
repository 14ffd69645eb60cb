"""What a lane of the walk's kernel holds: its photon, and what a step makes of it. Dr.Jit arrays throughout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class CollisionTarget:
    """What was met: chances of survival and absorption, shortest free path, phase function and redirect factor."""

    survive: Any
    loss: Any
    below: Any
    kind: Any
    g: Any
    offset: Any
    focus: Any
    redirect: Any


@dataclass
class Photon:
    """State of the photon that a lane walks; () stands for what is not followed.

    Attributes
    ----------
    layer, z
        Layer, and depth in mm below its own top: a thin layer keeps its digits on a thick one.
    mu, across
        Cosine of the direction with the normal (down is positive), and the other two components.
    place
        (x, y) in mm.
    weight
        Part of the photon that is left, negative after a factor cos θ < 0.
    steps
        Taken so far.
    """

    layer: Any
    z: Any
    mu: Any
    across: Any
    place: Any
    weight: Any
    steps: Any


@dataclass
class FlightStep:
    """One step of a photon.

    Attributes
    ----------
    up
        Whether it goes upwards.
    depth
        Thickness of the layer it lies in, mm.
    free, winner
        Free path drawn, and in the analog walk whose draw won.
    met
        Whether it ends in a collision.
    path
        Length in mm.
    place
        Where it ends, () where places are not followed.
    side
        Whether it leaves through a side, None without sides.
    """

    up: Any
    depth: Any
    free: Any
    winner: Any
    met: Any
    path: Any
    place: Any
    side: Any


@dataclass
class CollisionResult:
    """Direction and weight after a collision, what was absorbed, and what the redirect factor took."""

    mu: Any
    across: Any
    weight: Any
    absorbed: Any
    loss: Any


@dataclass
class InterfaceResult:
    """Whether light passes an interface, its cosine behind (signed and not), and the ratio of indices."""

    cross: Any
    mu: Any
    cosine: Any
    eta: Any
