"""The quiet part of a path inside: flights that cannot reach the surface, and meetings that ask for no light.

Many steps of many paths are of this kind. They form a loop of their own, so that a vector of lanes casts rays and
weighs light only once for several steps; it ends for a lane that needs either, and for all after a few rounds.
"""

from __future__ import annotations

from livlab.model.tracer.collision import meet
from livlab.model.tracer.context import Context
from livlab.model.tracer.interface import cross_layers
from livlab.model.tracer.next_event import Peel
from livlab.model.tracer.state import BARRIER, CAST, END, LOST, MET, QUIET, WALK, State
from livlab.model.transport import rng as random

ROUNDS = 8
"""Steps after which the lanes of a vector look up from their walk."""


def stroll(context: Context, peel: Peel | None, s: State) -> State:
    """Walk on inside, as long as nothing but the walk is needed."""
    dr, mi = context.dr, context.mi
    rounds = dr.zeros(mi.UInt32, dr.width(s.row))
    most = dr.opaque(mi.UInt32, ROUNDS)
    walked: State = dr.while_loop(
        (s, rounds),
        lambda s, rounds: (s.pending <= QUIET) & (rounds < most),
        lambda s, rounds: (_round(context, peel, s), rounds + 1),
        labels=("s", "rounds"),
        label="stroll",
        mode="symbolic",
    )[0]
    return walked


def _round(context: Context, peel: Peel | None, s: State) -> State:
    dr, mi, flights = context.dr, context.mi, context.flights
    assert flights is not None
    if flights.layered:
        s = cross_layers(context, s, s.pending == BARRIER)
    walks = s.pending == WALK
    s.tau = random.exponential(context.d, s.stream.next_uint32())
    flight = flights.fly(s)
    holds, casts, lost, path, place = flights.settle(s, flight, walks)
    context.account(s, flight, path)
    s.place = place
    s.p = dr.fma(path, s.d, s.p)
    s.pending = dr.select(casts, CAST, s.pending)
    s.pending = dr.select(holds & flight.barrier, BARRIER, s.pending)
    arrives = holds & flight.meets
    s.meeting.layer = dr.select(arrives, flight.layer, s.meeting.layer)
    if context.short:
        s.meeting.within = dr.select(arrives, flight.within, s.meeting.within)
    s.pending = dr.select(arrives, mi.UInt32(MET), s.pending)
    s.pending = dr.select(lost, LOST, s.pending)
    if context.fence is not None:
        s.pending = dr.select(walks & context.fence(s.p), END, s.pending)
    s = meet(context, peel, s)
    s.steps = s.steps + 1
    return s
