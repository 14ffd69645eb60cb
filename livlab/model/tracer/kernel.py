"""The tracer's loop: each lane follows paths from the camera through a scene with a body of tissue, one after another.

A step does for every lane what its stroll could not: it casts a ray, for a lane outside or one inside whose flight may
reach the surface, reflects or refracts what came to an interface, and adds the light that was met or asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from livlab.model.tracer.context import Context
from livlab.model.tracer.flight import Flight
from livlab.model.tracer.interface import cross
from livlab.model.tracer.interior import stroll
from livlab.model.tracer.medium import NONE
from livlab.model.tracer.next_event import Asked, Peel
from livlab.model.tracer.objects import Objects
from livlab.model.tracer.state import (
    ASK,
    BARRIER,
    CAST,
    END,
    LOST,
    MET,
    OUT,
    TURN,
    WALK,
    Aim,
    Ledger,
    Meeting,
    Place,
    State,
)
from livlab.model.tracer.surface import FAR, Hit
from livlab.model.transport import rng as random


@dataclass(frozen=True)
class Plan:
    """What a launch does.

    Attributes
    ----------
    rows, lanes
        Rows of the film, and lanes that share them: lane i follows rows i, i + lanes, ...
    samples
        Paths of a row.
    """

    rows: int
    lanes: int
    samples: int


class Kernel:
    """Traces one step for a given scene; numbers are data, what the scene lacks leaves no code."""

    def __init__(self, context: Context) -> None:
        self.context, self.mi, self.dr = context, context.mi, context.dr
        self.peel = Peel(context) if context.next_event else None
        self.objects = Objects(context) if context.others else None

    def start(self, stream: Any, n: int) -> State:
        """Lanes that are about to begin their first path."""
        dr, mi, m = self.dr, self.mi, self.context.medium
        zero, none = partial(dr.zeros, mi.Float, n), partial(dr.zeros, mi.UInt32, n)
        place = Place((), (), (), (), zero() if self.context.short else ())
        if self.context.field:
            place = Place(zero(), dr.zeros(mi.Vector3f, n), zero(), zero(), place.since)
        elif self.peel is not None:
            place.inward = dr.zeros(mi.Vector3f, n)
        ledger = Ledger([], [], [], (), (), zero() + 1.0, [])
        meeting, aim, tau = Meeting((), (), (), (), (), (), ()), Aim((), (), (), ()), ()
        if m is not None:
            tau = zero()
            ledger.lengths = [zero() for _ in range(m.m.layers)] if m.several else []
            ledger.counts = [zero() for _ in m.counted]
            ledger.rows = [zero() for _ in range(self.context.width)] if m.vector else []
            ledger.forced = none() if self.context.forces else ()
            ledger.first = none() if m.first else ()
            meeting.layer = none()
            meeting.within = zero() if m.short else ()
        if self.objects is not None:
            ledger.carried = [zero() + 1.0 for _ in range(self.context.width)]
        if self.peel is not None:
            turned = zero() if self.peel.shares.needed else ()
            meeting = Meeting(meeting.layer, meeting.within, zero(), zero(), zero(), zero(), turned)
            aim = Aim(none(), dr.zeros(mi.Point2f, n), dr.zeros(mi.Point3f, n), dr.full(mi.Bool, False, n))
        return self.renew(
            State(
                stream,
                dr.arange(mi.UInt32, n),
                none(),
                none(),
                none(),
                none(),
                tau,
                dr.zeros(mi.Point3f, n),
                dr.zeros(mi.Vector3f, n),
                place,
                meeting,
                aim,
                ledger,
                dr.full(mi.Bool, True, n),
                zero(),
                self.objects.start(n) if self.objects is not None else (),
                [zero() for _ in range(self.context.width)],
                none(),
                none(),
            ),
            dr.full(mi.Bool, True, n),
        )

    def renew(self, s: State, done: Any) -> State:
        """A new ray of the camera in the lanes whose path has ended."""
        dr, mi, m = self.dr, self.mi, self.context.medium
        choose = partial(dr.select, done)
        origin, direction = self.context.camera(s.stream, s.row)
        if self.context.width > 1:
            u = self.context.uniform(s)
            s.hero = choose(dr.minimum(mi.UInt32(u * self.context.width), self.context.width - 1), s.hero)
        s.p, s.d = choose(origin, s.p), choose(direction, s.d)
        s.medium, s.steps, s.pending = choose(0, s.medium), choose(0, s.steps), choose(OUT, s.pending)
        s.fresh, s.covered = s.fresh | done, choose(0.0, s.covered)
        ledger = s.ledger
        ledger.common = choose(1.0, ledger.common)
        if self.objects is not None:
            ledger.carried = [choose(1.0, x) for x in ledger.carried]
            s.bounce.density, s.bounce.count = choose(0.0, s.bounce.density), choose(0, s.bounce.count)
        if m is not None:
            ledger.lengths = [choose(0.0, x) for x in ledger.lengths]
            ledger.counts = [choose(0.0, x) for x in ledger.counts]
            ledger.rows = [choose(0.0, x) for x in ledger.rows]
            ledger.forced = choose(m.m.layers, ledger.forced) if self.context.forces else ()
            ledger.first = choose(NONE, ledger.first) if m.first else ()
        return s

    def trace(self, film: Any, plan: Plan, seed: int, number: int) -> Any:
        """Follow all samples of a plan; adds radiance to the film's rows and returns the lanes' troubles."""
        dr, mi = self.dr, self.mi
        stream = random.streams(self.context.d, plan.lanes, seed, number)
        self.rows, self.lanes, self.samples = (dr.opaque(mi.UInt32, n) for n in (plan.rows, plan.lanes, plan.samples))
        state = self.start(stream, plan.lanes)
        state = dr.while_loop(
            (state,),
            lambda s: s.row < self.rows,
            lambda s: (self.step(s, film),),
            labels=("s",),
            label="tracer",
            mode="symbolic",
        )[0]
        dr.eval(state.troubles, film)
        return state.troubles

    def step(self, s: State, film: Any) -> State:
        """Stroll, then do what the lanes need."""
        dr, mi = self.dr, self.mi
        flight: Flight | None = None
        longest, cast = mi.Float(FAR), s.pending == OUT
        if self.context.flights is not None:
            s = stroll(self.context, self.peel, s)
            cast = (s.pending == OUT) | (s.pending == CAST)
            flight = self.context.flights.fly(s)
            if self.context.flights.layered:
                longest = dr.select(s.pending == OUT, longest, flight.reach)
        ray = mi.Ray3f(s.p, s.d)
        ray.maxt = longest
        hit = self.context.surface.meet(ray, cast)
        out = s.pending == OUT
        met = out & hit.other
        shares = self.peel.shares.met(s) if self.peel is not None else None
        seen = self.context.lights.seen(s, out & ~hit.valid, met, hit, shares)
        s.pending = dr.select(out & (~hit.valid | hit.other), END, s.pending)
        if self.objects is not None:
            share = self.objects.share(s, hit, out & (~hit.valid | hit.other))
            seen = [x * y * share for x, y in zip(seen, s.ledger.carried, strict=True)]
            lit, s = self.objects.meet(s, hit, met)
            seen = [x + y for x, y in zip(seen, lit, strict=True)]
        if self.context.flights is not None and flight is not None:
            asks = s.pending == ASK
            asked = self.peel.ask(s, asks) if self.peel is not None else None
            self.weigh(s, seen, asked)
            s.pending = dr.select(asks, TURN, s.pending)
            s = self.arrive(s, flight, hit, out)
        else:
            self.deposit(s, [s.ledger.common * x for x in seen])
        s.steps = s.steps + 1
        late = (s.steps >= self.context.max_steps) & (s.pending != END)
        s.troubles = s.troubles + dr.select(late, mi.UInt32(1), 0)
        return self.next(s, film, late | (s.pending == END))

    def next(self, s: State, film: Any, done: Any) -> State:
        """Turn to the lane's next sample; what a row has seen is written once, when its last is done."""
        dr, mi = self.dr, self.mi
        turn = s.turn + dr.select(done, mi.UInt32(1), 0)
        over = turn >= self.samples
        keep_row(mi, dr, film, s.light, s.row, self.context.padded, over)
        s.light = [dr.select(over, 0.0, x) for x in s.light]
        s.turn = dr.select(over, 0, turn)
        s.row = s.row + dr.select(over, self.lanes, 0)
        return self.renew(s, done)

    def arrive(self, s: State, flight: Flight, hit: Hit, outside: Any) -> State:
        """Take lanes to what their ray has met, or to the end of their flight, and across an interface there."""
        dr, mi, flights = self.dr, self.mi, self.context.flights
        assert flights is not None
        inside, lost = s.pending == CAST, s.pending == LOST
        near = inside & hit.valid & (hit.t <= flight.reach)
        exits = near & hit.body & self.context.leaves(s, hit)
        stray = near & ~exits
        # A ray from a point that rounding put on the surface may miss it: what then is outside has left there.
        missed, over = inside & ~hit.valid, mi.Float(0.0)
        if flights.layered:
            depth = s.place.depth
            missed &= dr.fma(flight.slope, flight.reach, depth) < -flights.slack
            over = dr.select(missed, dr.maximum(-depth * dr.rcp(dr.minimum(flight.slope, -1e-6)), 0.0), 0.0)
        lost |= missed
        goes = inside & ~lost
        creep = hit.t + self.context.creep(s.p, hit)
        path = dr.select(exits, hit.t, dr.select(stray, dr.minimum(creep, flight.reach), flight.reach))
        path = dr.select(goes, path, over)
        whole = goes & ~near
        enters = outside & hit.body & hit.outward
        # A camera may stand inside; at a silhouette even one outside sees a facet's back.
        begins = outside & hit.body & ~hit.outward & s.fresh & mi.Bool(self.context.options.camera_within)
        passes = outside & hit.body & ~hit.outward & ~begins
        self.context.account(s, flight, path)
        s.place = flights.moved(s.place, flight, path)
        if self.context.field and not flights.layered:
            s.place.trust = dr.select(inside, 0.0, s.place.trust)
        s.p = dr.fma(dr.select(passes, creep, path), s.d, s.p)
        s.p = dr.select(enters | exits, hit.p, s.p)
        s.medium = dr.select(begins, self.begin(), s.medium)
        s.pending = dr.select(begins | goes, WALK, s.pending)
        arrives = whole & flight.meets
        s.pending = dr.select(arrives, MET, s.pending)
        s.meeting.layer = dr.select(arrives, flight.layer, s.meeting.layer)
        if self.context.short:
            s.meeting.within = dr.select(arrives, flight.within, s.meeting.within)
        s.pending = dr.select(whole & flight.barrier, BARRIER, s.pending)
        s = cross(self.context, s, hit, enters, exits, lost)
        if self.context.field:
            s.place.trust = dr.select(begins, 0.0, s.place.trust)
            s.place.clear = dr.select(begins, 0.0, s.place.clear)
        if self.context.fence is not None:
            s.pending = dr.select((enters | exits | lost | goes) & self.context.fence(s.p), END, s.pending)
            exits, lost = exits & (s.pending != END), lost & (s.pending != END)
        crossed = enters | exits | lost
        s.pending = dr.select(crossed, dr.select(s.medium == 0, mi.UInt32(OUT), WALK), s.pending)
        s.fresh &= ~(crossed | begins)
        if self.peel is not None:
            s = self.peel.take_aim(s, (enters & (s.medium != 0)) | begins)
        s.troubles = s.troubles + dr.select(lost, mi.UInt32(1 << 16), 0)
        return s

    def begin(self) -> Any:
        """Region of a camera that stands inside: the innermost; a layer's is found at the first look."""
        assert self.context.medium is not None
        return self.mi.UInt32(len(self.context.medium.m.regions))

    def weigh(self, s: State, seen: list[Any], asked: Asked | None) -> None:
        """Weigh what light was met, or reaches a meeting from a lamp, at every wavelength, and add it to the film."""
        dr, m = self.dr, self.context.medium
        assert m is not None
        zero = [self.mi.Float(0.0)] * self.context.width
        if asked is None:
            weight = m.weights(s.ledger, zero, None, zero)
            value = seen
        else:
            weight = m.weights(s.ledger, asked.extra, asked.lengths, asked.met)
            lamp = asked.strength
            if self.objects is not None:
                lamp = [x * y for x, y in zip(lamp, s.ledger.carried, strict=True)]
            value = [dr.select(asked.active, x, y) for x, y in zip(lamp, seen, strict=True)]
        self.deposit(s, [s.ledger.common * w * x for w, x in zip(weight, value, strict=True)])

    def deposit(self, s: State, value: Sequence[Any]) -> None:
        """Add light to what the lane's row has seen."""
        s.light = [x + y for x, y in zip(s.light, value, strict=True)]


def keep_row(mi: Any, dr: Any, film: Any, light: Sequence[Any], row: Any, padded: int, over: Any) -> None:
    """Write a row of the film."""
    if padded == 1:
        dr.scatter(film, light[0], row, over)
        return
    values = mi.ArrayXf([*light, *[mi.Float(0.0) + 0.0 * light[0]] * (padded - len(light))])
    dr.scatter(film, values, row, over)
