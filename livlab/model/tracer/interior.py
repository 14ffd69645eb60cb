"""The interior walk: flights that cannot reach the surface, and collisions that sample no lamp.

Many steps of many paths are of this kind. They form a loop of their own, so that a vector of lanes casts rays and
weighs light only once for several steps; it ends for a lane that needs either, and for all after a few rounds.
"""

from __future__ import annotations

from livlab.model.tracer.collision import collide
from livlab.model.tracer.context import Context
from livlab.model.tracer.interface import cross_layers
from livlab.model.tracer.next_event import NextEvent
from livlab.model.tracer.state import CAST, COLLIDE, END, INTERFACE, LAST_INTERIOR, LOST, WALK, PathState
from livlab.model.transport import rng as random

ROUNDS = 8
"""Steps after which the lanes of a vector look up from their walk."""


def interior_walk(context: Context, next_event: NextEvent | None, s: PathState) -> PathState:
    """Walk on inside, as long as no ray is to be cast and no light to be weighed."""
    dr, mi = context.dr, context.mi
    rounds = dr.zeros(mi.UInt32, dr.width(s.row))
    most = dr.opaque(mi.UInt32, ROUNDS)
    walked: PathState = dr.while_loop(
        (s, rounds),
        lambda s, rounds: (s.pending <= LAST_INTERIOR) & (rounds < most),
        lambda s, rounds: (_round(context, next_event, s), rounds + 1),
        labels=("s", "rounds"),
        label="interior walk",
        mode="symbolic",
    )[0]
    return walked


def _round(context: Context, next_event: NextEvent | None, s: PathState) -> PathState:
    dr, mi, flights = context.dr, context.mi, context.flights
    assert flights is not None
    if flights.layered:
        s = cross_layers(context, s, s.pending == INTERFACE)
    walks = s.pending == WALK
    s.tau = random.exponential(context.d, s.stream.next_uint32())
    flight = flights.fly(s)
    holds, casts, lost, path, place = flights.settle(s, flight, walks)
    context.record_step(s, flight, path)
    s.place = place
    s.p = dr.fma(path, s.d, s.p)
    s.pending = dr.select(casts, CAST, s.pending)
    s.pending = dr.select(holds & flight.barrier, INTERFACE, s.pending)
    arrives = holds & flight.collides
    s.collision.layer = dr.select(arrives, flight.layer, s.collision.layer)
    if context.short:
        s.collision.within = dr.select(arrives, flight.within, s.collision.within)
    s.pending = dr.select(arrives, mi.UInt32(COLLIDE), s.pending)
    s.pending = dr.select(lost, LOST, s.pending)
    if context.fence is not None:
        s.pending = dr.select(walks & context.fence(s.p), END, s.pending)
    s = collide(context, next_event, s)
    s.steps = s.steps + 1
    return s
