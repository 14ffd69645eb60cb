"""The tracer's loop: each lane follows paths from the camera through a scene with a body of tissue, one after another.

A step is one segment: outside from surface to surface, inside to a meeting, an interface, or as far as the last
look at the depth holds. The same ray cast serves a lane outside and one inside that may reach the surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from livlab.model.tracer.crossing import cross
from livlab.model.tracer.flight import FAR, Flight, Flights
from livlab.model.tracer.lights import Lights
from livlab.model.tracer.medium import NONE, Medium
from livlab.model.tracer.meeting import meet
from livlab.model.tracer.peel import Peel
from livlab.model.tracer.state import Ledger, Place, State
from livlab.model.transport import rng as random
from livlab.model.transport.device import Device

CREEP = 5e-7
"""Step, as part of the coordinates, past a hit that cannot be one: the surface that a ray has just left. A float knows
coordinates to 6e-8 of themselves."""


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


@dataclass
class Hit:
    """What a ray met: nothing, the body's surface (an interface and its outward normal), or something else."""

    valid: Any
    body: Any
    other: Any
    interface: Any
    t: Any
    normal: Any
    outward: Any
    si: Any


class Kernel:
    """Traces one step for a given scene; numbers are data, what the scene lacks leaves no code."""

    def __init__(
        self,
        d: Device,
        mi: Any,
        scene: Any,
        medium: Medium | None,
        flights: Flights | None,
        shapes: Sequence[Any],
        lights: Lights,
        camera: Callable[[Any, Any], tuple[Any, Any]],
        size: float,
        estimator: str,
        max_steps: int,
    ) -> None:
        self.d, self.mi, self.dr, self.scene = d, mi, d.dr, scene
        self.medium, self.flights, self.shapes, self.lights = medium, flights, shapes, lights
        self.camera = camera
        self.max_steps = d.dr.opaque(mi.UInt32, max_steps)
        self.least = d.dr.opaque(mi.Float, 0.01 * CREEP * size)
        self.width = len(lights.wavelengths)
        self.padded = lights.padded
        self.analog = estimator == "analog"
        self.peel = Peel(self, size) if medium is not None and lights.lamps else None
        self.forces = medium is not None and medium.lossy and not self.analog

    def start(self, stream: Any, n: int) -> State:
        """The first path of every lane."""
        dr, mi = self.dr, self.mi
        zero = dr.zeros(mi.Float, n)
        row = dr.arange(mi.UInt32, n)
        m = self.medium
        place = Place((), (), (), (), zero if m is not None and m.short else ())
        if self.peel is not None:
            place.inward = dr.zeros(mi.Vector3f, n)
        if self.flights is not None and self.flights.field is not None:
            place = Place(zero, dr.zeros(mi.Vector3f, n), zero, zero, place.since)
        ledger = Ledger([], [], [], (), (), dr.ones(mi.Float, n), [])
        if m is not None:
            ledger.lengths = [dr.zeros(mi.Float, n) for _ in range(m.m.layers)] if m.several else []
            ledger.counts = [dr.zeros(mi.Float, n) for _ in m.counted]
            ledger.rows = [dr.zeros(mi.Float, n) for _ in range(self.width)] if m.vector else []
            ledger.forced = dr.full(mi.UInt32, m.m.layers, n) if self.forces else ()
            ledger.first = dr.zeros(mi.UInt32, n) if m.first else ()
        state = State(
            stream,
            row,
            dr.zeros(mi.UInt32, n),
            dr.zeros(mi.UInt32, n),
            dr.zeros(mi.UInt32, n),
            dr.zeros(mi.Point3f, n),
            dr.zeros(mi.Vector3f, n),
            place,
            ledger,
            dr.full(mi.Bool, True, n),
            dr.full(mi.Bool, False, n),
            (),
            dr.zeros(mi.UInt32, n),
            dr.zeros(mi.UInt32, n),
        )
        return self.renew(state, dr.full(mi.Bool, True, n))

    def renew(self, s: State, done: Any) -> State:
        """A new ray of the camera in the lanes whose path has ended."""
        dr, mi = self.dr, self.mi
        choose = partial(dr.select, done)
        origin, direction = self.camera(s.stream, s.row)
        if self.width > 1:
            u = random.uniform(self.d, s.stream.next_uint32())
            s.hero = choose(dr.minimum(mi.UInt32(u * self.width), self.width - 1), s.hero)
        s.p, s.d = choose(origin, s.p), choose(direction, s.d)
        s.medium, s.steps = choose(0, s.medium), choose(0, s.steps)
        s.fresh, s.covered = s.fresh | done, s.covered & ~done
        ledger, m = s.ledger, self.medium
        ledger.common = choose(1.0, ledger.common)
        if m is not None:
            ledger.lengths = [choose(0.0, x) for x in ledger.lengths]
            ledger.counts = [choose(0.0, x) for x in ledger.counts]
            ledger.rows = [choose(0.0, x) for x in ledger.rows]
            ledger.forced = choose(m.m.layers, ledger.forced) if self.forces else ()
            ledger.first = choose(NONE, ledger.first) if m.first else ()
        return s

    def trace(self, film: Any, plan: Plan, seed: int, number: int) -> Any:
        """Follow all samples of a plan; adds radiance to the film's rows and returns the lanes' troubles."""
        dr, mi = self.dr, self.mi
        stream = random.streams(self.d, plan.lanes, seed, number)
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
        """One segment of every lane's path."""
        dr, mi, m = self.dr, self.mi, self.medium
        outside = s.medium == 0
        inside = ~outside
        flight: Flight | None = None
        lost = mi.Bool(False)
        place = s.place
        longest = mi.Float(FAR)
        cast = outside
        if m is not None and self.flights is not None:
            tau = random.exponential(self.d, s.stream.next_uint32())
            place, lost = self.flights.refresh(s, tau, inside)
            flight = self.flights.fly(s, place, tau)
            cast = outside | (inside & (flight.reach > self.flights.clear(place)))
            if self.flights.layered:
                longest = dr.select(outside, longest, flight.reach)
        hit = self.hit(s, cast, longest)
        missed, lamp = outside & ~hit.valid, outside & hit.valid & ~hit.body
        seen = [
            x + y
            for x, y in zip(self.lights.surrounding(s, missed), self.lights.met(hit, lamp & ~s.covered), strict=True)
        ]
        ended = outside & (~hit.valid | hit.other)
        if m is None or flight is None or self.flights is None:
            self.deposit(film, s, [s.ledger.common * x for x in seen])
        else:
            u = random.uniform(self.d, s.stream.next_uint32())
            exits = inside & hit.body & (hit.t <= flight.reach) & self.leaves(s, hit)
            stray = inside & cast & hit.valid & (hit.t <= flight.reach) & ~exits
            creep = self.creep(s.p)
            # A ray from a point that rounding put on the surface may miss it: what then is outside has left there.
            unhit, over = inside & cast & ~hit.valid & ~lost, mi.Float(0.0)
            if self.flights.layered:
                unhit &= dr.fma(flight.slope, flight.reach, place.depth) < -self.flights.slack
                over = dr.select(unhit, dr.maximum(-place.depth * dr.rcp(dr.minimum(flight.slope, -1e-6)), 0.0), 0.0)
            lost |= unhit
            path = dr.minimum(flight.reach, dr.select(stray, hit.t + creep, FAR))
            path = dr.select(exits, hit.t, path)
            path = dr.select(lost, over, dr.select(inside, path, 0.0))
            stays = inside & ~exits & ~stray & ~lost
            meets, barrier = stays & flight.meets, stays & flight.barrier
            enters = outside & hit.body & hit.outward
            passes = outside & hit.body & ~hit.outward & ~s.fresh
            begins = outside & hit.body & ~hit.outward & s.fresh
            place = self.account(s, place, flight, path)
            s.p = dr.fma(dr.select(passes, hit.t + creep, path), s.d, s.p)
            s.p = dr.select(enters | exits, hit.si.p, s.p)
            s.medium = dr.select(begins, self.region_at(s), s.medium)
            place, dead = meet(self, s, place, flight, meets, seen, film)
            place = cross(self, s, place, hit, enters, exits, lost, barrier, u)
            if self.flights.field is not None:
                place.trust = dr.select(begins, 0.0, place.trust)
                place.clear = dr.select(begins, 0.0, place.clear)
            s.place = place
            s.fresh &= inside | passes
            ended |= dead
        s.steps = s.steps + 1
        given_up = (s.steps >= self.max_steps) & ~ended
        s.troubles = s.troubles + dr.select(given_up, mi.UInt32(1), 0) + dr.select(lost, mi.UInt32(1 << 16), 0)
        return self.next(s, ended | given_up)

    def next(self, s: State, done: Any) -> State:
        """Turn to the lane's next sample."""
        dr, mi = self.dr, self.mi
        turn = s.turn + dr.select(done, mi.UInt32(1), 0)
        over = turn >= self.samples
        s.turn = dr.select(over, 0, turn)
        s.row = s.row + dr.select(over, self.lanes, 0)
        return self.renew(s, done)

    def creep(self, p: Any) -> Any:
        """How far to go on from a hit that cannot be one."""
        dr = self.dr
        return dr.fma(dr.maximum(dr.maximum(dr.abs(p.x), dr.abs(p.y)), dr.abs(p.z)), CREEP, self.least)

    def hit(self, s: State, cast: Any, longest: Any) -> Hit:
        """Cast a lane's ray."""
        ray = self.mi.Ray3f(s.p, s.d)
        ray.maxt = longest
        return self.meet_surface(ray, cast, self.mi.RayFlags.Minimal | self.mi.RayFlags.ShadingFrame)

    def hit_surface(self, p: Any, d: Any, cast: Any) -> Hit:
        """Cast a ray from inside to the surface, to learn its curvature there, too."""
        flags = self.mi.RayFlags.ShadingFrame | self.mi.RayFlags.dPdUV | self.mi.RayFlags.dNSdUV
        return self.meet_surface(self.mi.Ray3f(p, d), cast, flags)

    def meet_surface(self, ray: Any, cast: Any, flags: Any) -> Hit:
        """What a ray meets."""
        dr, mi = self.dr, self.mi
        found = self.scene.ray_intersect_preliminary(ray, coherent=False, active=cast)
        valid = cast & found.is_valid()
        si = found.compute_surface_interaction(ray, flags, valid)
        interface, body = mi.UInt32(0), mi.Bool(False)
        for k, shape in enumerate(self.shapes):
            mine = found.shape == shape
            body |= mine
            interface = dr.select(mine, mi.UInt32(k), interface)
        body &= valid
        outward = dr.dot(si.n, ray.d) < 0.0
        # A normal of the smoothed surface that looks away from the ray would send light through it.
        smooth = si.sh_frame.n
        agrees = (dr.dot(smooth, ray.d) < 0.0) == outward
        normal = dr.select(agrees, smooth, si.n)
        return Hit(valid, body, valid & ~body, interface, dr.select(valid, found.t, FAR), normal, outward, si)

    def leaves(self, s: State, hit: Hit) -> Any:
        """Whether a hit from inside is of an interface of the path's own region, from the right side."""
        if len(self.shapes) == 1:
            return ~hit.outward
        region = s.medium - 1
        return ((hit.interface == region) & ~hit.outward) | ((hit.interface == region + 1) & hit.outward)

    def region_at(self, s: State) -> Any:
        """Region of a camera that stands inside: the innermost, or as its depth says."""
        mi, m = self.mi, self.medium
        assert m is not None and self.flights is not None
        regions = len(m.m.regions)
        if self.flights.field is None or not self.flights.layered:
            return mi.UInt32(regions)
        depth, _ = self.flights.field.look(s.p, True)
        region = mi.UInt32(1)
        for r in range(1, regions):
            region = self.dr.select(depth >= m.region_top[r], mi.UInt32(r + 1), region)
        return region

    def account(self, s: State, place: Place, flight: Flight, path: Any) -> Place:
        """Enter a step into the ledger."""
        assert self.flights is not None and self.medium is not None
        if self.medium.several:
            parts = self.flights.lengths(flight, path)
            s.ledger.lengths = [x + y for x, y in zip(s.ledger.lengths, parts, strict=True)]
        return self.flights.moved(place, flight, path)

    def deposit(self, film: Any, s: State, value: Sequence[Any]) -> None:
        """Add light to the row of the film that only this lane writes."""
        dr, mi = self.dr, self.mi
        some = mi.Bool(False)
        for x in value:
            some |= x != 0.0
        for w, x in enumerate(value):
            dr.scatter_add(film, x, s.row * self.padded + w, some, mode=dr.ReduceMode.NoConflicts)
