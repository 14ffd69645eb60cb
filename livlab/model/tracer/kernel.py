"""The tracer's loop: each lane follows paths from the camera through a scene with a body of tissue, one after another.

A step does for every lane what its interior walk could not: it casts a ray, for a lane outside or one inside whose
flight may reach the surface, reflects or refracts what came to an interface, and adds light that was hit or sampled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from livlab.model.tracer.context import Context
from livlab.model.tracer.flight import Flight
from livlab.model.tracer.given_up import Leftover
from livlab.model.tracer.interface import cross
from livlab.model.tracer.interior import interior_walk
from livlab.model.tracer.medium import NONE
from livlab.model.tracer.next_event import DirectLight, NextEvent
from livlab.model.tracer.objects import Objects
from livlab.model.tracer.state import (
    CAST,
    COLLIDE,
    END,
    INTERFACE,
    LOST,
    NEXT_EVENT,
    OUTSIDE,
    SCATTER,
    WALK,
    Collision,
    LampSample,
    PathState,
    Place,
    Throughput,
)
from livlab.model.tracer.surface import FAR, Hit
from livlab.model.transport import rng as random


@dataclass(frozen=True)
class LaunchPlan:
    """What a launch does.

    Attributes
    ----------
    rows, lanes
        Rows of the film, and lanes that share them: lane i follows rows i, i + lanes, ...
    samples
        Paths of a row.
    leftover
        Takes what paths still weigh that are given up.
    """

    rows: int
    lanes: int
    samples: int
    leftover: Leftover


class Kernel:
    """Traces one step for a given scene; numbers are data, what the scene lacks leaves no code."""

    def __init__(self, context: Context) -> None:
        self.context, self.mi, self.dr = context, context.mi, context.dr
        self.next_event = NextEvent(context) if context.next_event else None
        self.objects = Objects(context) if context.others else None

    def start(self, stream: Any, n: int) -> PathState:
        """Lanes that are about to begin their first path."""
        dr, mi, context = self.dr, self.mi, self.context
        zero, none = partial(dr.zeros, mi.Float, n), partial(dr.zeros, mi.UInt32, n)
        lamp = LampSample()
        if self.next_event is not None:
            lamp = LampSample(
                number=none(),
                sample=dr.zeros(mi.Point2f, n),
                spot=dr.zeros(mi.Point3f, n),
                distant=dr.full(mi.Bool, False, n),
            )
        state = PathState(
            stream=stream,
            row=dr.arange(mi.UInt32, n),
            sample=none(),
            hero=none(),
            medium=none(),
            pending=none(),
            tau=zero() if context.medium is not None else (),
            p=dr.zeros(mi.Point3f, n),
            d=dr.zeros(mi.Vector3f, n),
            place=self._place(n),
            collision=self._collision(n),
            lamp=lamp,
            throughput=self._throughput(n),
            fresh=dr.full(mi.Bool, True, n),
            covered=zero(),
            bounce=self.objects.start(n) if self.objects is not None else (),
            light=[zero() for _ in range(context.width)],
            steps=none(),
            strayed=none(),
        )
        return self.renew(state, dr.full(mi.Bool, True, n))

    def _place(self, n: int) -> Place:
        dr, mi, context = self.dr, self.mi, self.context
        zero = partial(dr.zeros, mi.Float, n)
        place = Place(since=zero() if context.short else ())
        if context.field:
            place.depth, place.trust, place.clear = zero(), zero(), zero()
        if context.field or self.next_event is not None:
            place.inward = dr.zeros(mi.Vector3f, n)
        return place

    def _collision(self, n: int) -> Collision:
        zero, collision = partial(self.dr.zeros, self.mi.Float, n), Collision()
        if self.context.medium is not None:
            collision.layer = self.dr.zeros(self.mi.UInt32, n)
            collision.within = zero() if self.context.short else ()
        if self.next_event is not None:
            collision.code, collision.g, collision.base, collision.probability = zero(), zero(), zero(), zero()
            collision.pdf = zero() if self.next_event.weights.needed else ()
        return collision

    def _throughput(self, n: int) -> Throughput:
        zero, none = partial(self.dr.zeros, self.mi.Float, n), partial(self.dr.zeros, self.mi.UInt32, n)
        m, width = self.context.medium, self.context.width
        sums = Throughput(common=zero() + 1.0)
        if m is not None:
            sums.lengths = [zero() for _ in range(m.m.layers)] if m.several else []
            sums.counts = [zero() for _ in m.counted]
            sums.rows = [zero() for _ in range(width)] if m.vector else []
            sums.forced = none() if self.context.forces else ()
            sums.first = none() if m.first else ()
        if self.objects is not None:
            sums.carried = [zero() + 1.0 for _ in range(width)]
        return sums

    def renew(self, s: PathState, done: Any) -> PathState:
        """A new ray of the camera in the lanes whose path has ended."""
        dr, mi, m = self.dr, self.mi, self.context.medium
        choose = partial(dr.select, done)
        origin, direction = self.context.camera(s.stream, s.row)
        if self.context.width > 1:
            u = self.context.uniform(s)
            s.hero = choose(dr.minimum(mi.UInt32(u * self.context.width), self.context.width - 1), s.hero)
        s.p, s.d = choose(origin, s.p), choose(direction, s.d)
        s.medium, s.steps, s.pending = choose(0, s.medium), choose(0, s.steps), choose(OUTSIDE, s.pending)
        s.fresh, s.covered = s.fresh | done, choose(0.0, s.covered)
        throughput = s.throughput
        throughput.common = choose(1.0, throughput.common)
        if self.objects is not None:
            throughput.carried = [choose(1.0, x) for x in throughput.carried]
            s.bounce.pdf, s.bounce.count = choose(0.0, s.bounce.pdf), choose(0, s.bounce.count)
        if m is not None:
            throughput.lengths = [choose(0.0, x) for x in throughput.lengths]
            throughput.counts = [choose(0.0, x) for x in throughput.counts]
            throughput.rows = [choose(0.0, x) for x in throughput.rows]
            throughput.forced = choose(m.m.layers, throughput.forced) if self.context.forces else ()
            throughput.first = choose(NONE, throughput.first) if m.first else ()
        return s

    def trace(self, film: Any, plan: LaunchPlan, seed: int, number: int) -> Any:
        """Follow all samples of a plan; adds radiance to the film's rows and returns each lane's strayed paths."""
        dr, mi = self.dr, self.mi
        stream = random.streams(self.context.d, plan.lanes, seed, number)
        self.rows, self.lanes, self.samples = (dr.opaque(mi.UInt32, n) for n in (plan.rows, plan.lanes, plan.samples))
        self.leftover = plan.leftover
        state = self.start(stream, plan.lanes)
        state = dr.while_loop(
            (state,),
            lambda s: s.row < self.rows,
            lambda s: (self.step(s, film),),
            labels=("s",),
            label="tracer",
            mode="symbolic",
        )[0]
        dr.eval(state.strayed, film, plan.leftover.sums, plan.leftover.paths)
        return state.strayed

    def step(self, s: PathState, film: Any) -> PathState:
        """Walk inside, then do what the lanes need."""
        dr, mi = self.dr, self.mi
        flight: Flight | None = None
        longest, cast = mi.Float(FAR), s.pending == OUTSIDE
        if self.context.flights is not None:
            s = interior_walk(self.context, self.next_event, s)
            cast = (s.pending == OUTSIDE) | (s.pending == CAST)
            flight = self.context.flights.fly(s)
            if self.context.flights.layered:
                longest = dr.select(s.pending == OUTSIDE, longest, flight.reach)
        ray = mi.Ray3f(s.p, s.d)
        ray.maxt = longest
        hit = self.context.surface.intersect(ray, cast)
        out = s.pending == OUTSIDE
        weight = self.next_event.weights.of_hit(s) if self.next_event is not None else None
        seen = self.context.lights.seen(s, out & ~hit.valid, out & hit.other, hit, weight)
        s.pending = dr.select(out & (~hit.valid | hit.other), END, s.pending)
        if self.objects is not None:
            mis = self.objects.mis_weight(s, hit, out & (~hit.valid | hit.other))
            seen = [x * y * mis for x, y in zip(seen, s.throughput.carried, strict=True)]
            lit, s = self.objects.reflect(s, hit, out & hit.other)
            seen = [x + y for x, y in zip(seen, lit, strict=True)]
        if self.context.flights is not None and flight is not None:
            samples = s.pending == NEXT_EVENT
            direct = self.next_event.estimate(s, samples) if self.next_event is not None else None
            self.weigh(s, seen, direct)
            s.pending = dr.select(samples, SCATTER, s.pending)
            s = self.arrive(s, flight, hit, out)
        else:
            self.deposit(s, [s.throughput.common * x for x in seen])
        s.steps = s.steps + 1
        given_up = self.give_up(s)
        return self.next(s, film, given_up | (s.pending == END))

    def give_up(self, s: PathState) -> Any:
        """Lanes whose path has gone too far without an end; what it still weighs is kept."""
        dr, mi = self.dr, self.mi
        bounced = mi.Bool(False)
        if self.objects is not None:
            bounced = s.bounce.count >= self.context.max_bounces
        gone = ((s.steps >= self.context.max_steps) | bounced) & (s.pending != END)

        def keep(throughput: Throughput, row: Any, bounced: Any) -> Any:
            self.leftover.add(row, self.remaining(throughput), bounced)
            return row

        dr.if_stmt(
            (s.throughput, s.row, bounced),
            gone,
            keep,
            lambda throughput, row, bounced: row,
            arg_labels=("throughput", "row", "bounced"),
            label="given up",
            mode="symbolic",
        )
        return gone

    def remaining(self, throughput: Throughput) -> list[Any]:
        """What a path weighs at every wavelength."""
        m, width = self.context.medium, self.context.width
        weight: list[Any] = [throughput.common] * width
        if m is not None:
            zero = [self.mi.Float(0.0)] * width
            found = m.weights(throughput, lengths=None, log_scatter=zero, log_collide=zero)
            weight = [x * y for x, y in zip(weight, found, strict=True)]
        if self.objects is not None:
            weight = [x * y for x, y in zip(weight, throughput.carried, strict=True)]
        return weight

    def next(self, s: PathState, film: Any, done: Any) -> PathState:
        """Turn to the lane's next sample; what a row has seen is written once, when its last is done."""
        dr, mi = self.dr, self.mi
        sample = s.sample + dr.select(done, mi.UInt32(1), 0)
        over = sample >= self.samples
        keep_row(mi, dr, film, s.light, s.row, self.context.padded, over)
        s.light = [dr.select(over, 0.0, x) for x in s.light]
        s.sample = dr.select(over, 0, sample)
        s.row = s.row + dr.select(over, self.lanes, 0)
        return self.renew(s, done)

    def arrive(self, s: PathState, flight: Flight, hit: Hit, outside: Any) -> PathState:
        """Take lanes to what their ray has hit, or to the end of their flight, and across an interface there."""
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
        self.context.record_step(s, flight, path)
        s.place = flights.moved(s.place, flight, path)
        if self.context.field and not flights.layered:
            s.place.trust = dr.select(inside, 0.0, s.place.trust)
        s.p = dr.fma(dr.select(passes, creep, path), s.d, s.p)
        s.p = dr.select(enters | exits, hit.p, s.p)
        s.medium = dr.select(begins, self.begin(), s.medium)
        s.pending = dr.select(begins | goes, WALK, s.pending)
        arrives = whole & flight.collides
        s.pending = dr.select(arrives, COLLIDE, s.pending)
        s.collision.layer = dr.select(arrives, flight.layer, s.collision.layer)
        if self.context.short:
            s.collision.within = dr.select(arrives, flight.within, s.collision.within)
        s.pending = dr.select(whole & flight.barrier, INTERFACE, s.pending)
        s = cross(self.context, s, hit, enters, exits, lost)
        if self.context.field:
            s.place.trust = dr.select(begins, 0.0, s.place.trust)
            s.place.clear = dr.select(begins, 0.0, s.place.clear)
        if self.context.fence is not None:
            s.pending = dr.select((enters | exits | lost | goes) & self.context.fence(s.p), END, s.pending)
            exits, lost = exits & (s.pending != END), lost & (s.pending != END)
        crossed = enters | exits | lost
        s.pending = dr.select(crossed, dr.select(s.medium == 0, mi.UInt32(OUTSIDE), WALK), s.pending)
        s.fresh &= ~(crossed | begins)
        if self.next_event is not None:
            s = self.next_event.sample_lamp(s, (enters & (s.medium != 0)) | begins)
        s.strayed = s.strayed + dr.select(lost, mi.UInt32(1), 0)
        return s

    def begin(self) -> Any:
        """Region of a camera that stands inside: the innermost; a layer's is found at the first look."""
        assert self.context.medium is not None
        return self.mi.UInt32(len(self.context.medium.m.regions))

    def weigh(self, s: PathState, seen: list[Any], direct: DirectLight | None) -> None:
        """Weigh what light was hit, or reaches a collision from a lamp, at every wavelength, and add it to the film."""
        dr, m = self.dr, self.context.medium
        assert m is not None
        if direct is None:
            zero = [self.mi.Float(0.0)] * self.context.width
            weight = m.weights(s.throughput, lengths=None, log_scatter=zero, log_collide=zero)
            value = seen
        else:
            weight = m.weights(
                s.throughput,
                lengths=direct.lengths,
                log_scatter=direct.log_scatter,
                log_collide=direct.log_collide,
            )
            lamp = direct.radiance
            if self.objects is not None:
                lamp = [x * y for x, y in zip(lamp, s.throughput.carried, strict=True)]
            value = [dr.select(direct.active, x, y) for x, y in zip(lamp, seen, strict=True)]
        self.deposit(s, [s.throughput.common * w * x for w, x in zip(weight, value, strict=True)])

    def deposit(self, s: PathState, value: Sequence[Any]) -> None:
        """Add light to what the lane's row has seen."""
        s.light = [x + y for x, y in zip(s.light, value, strict=True)]


def keep_row(mi: Any, dr: Any, film: Any, light: Sequence[Any], row: Any, padded: int, over: Any) -> None:
    """Write a row of the film."""
    if padded == 1:
        dr.scatter(film, light[0], row, over)
        return
    values = mi.ArrayXf([*light, *[mi.Float(0.0) + 0.0 * light[0]] * (padded - len(light))])
    dr.scatter(film, values, row, over)
