"""The walk itself: one symbolic loop, many lanes, each walking its share of photons one after the other.

A lane starts its next photon in the step in which the last one ended, so that no lane of a vector waits for
the longest walk in it. Coefficients of every layer at the lane's wavelength stay in registers and are
chosen by comparison with the layer's number; only the winner of several elements is looked up in memory.
The code depends on `Shape` and on which records are asked for; every number is data.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

import numpy as np

from livlab.model.transport import rng as random
from livlab.model.transport.fresnel import fresnel, refracted_cosine
from livlab.model.transport.walk import events, roulette
from livlab.model.transport.walk.columns import Columns, Settings
from livlab.model.transport.walk.observers import End, Observer, Step
from livlab.model.transport.walk.states import CollisionResult, CollisionTarget, FlightStep, InterfaceResult, Photon
from livlab.model.transport.walk.tables import ISOTROPIC

NEGLIGIBLE = 1e-9
"""A weight that redirect factors brought below this is given up and counted as residual."""

LUMP = 2.0**-12
"""Where less than this share is lost at a collision, this share is lost, more rarely: a single-precision weight
takes a loss of 1e-9 for none."""

_TINY = 1e-20
_FAR = 1e30  # a clear endless layer is crossed, not lost in NaN


class _Walk:
    """Traces one step of the walk for a given shape."""

    def __init__(self, columns: Columns, settings: Settings, observers: Sequence[Observer]) -> None:
        self.c, self.s, self.observers = columns, settings, observers
        self.d, self.dr, self.shape = columns.d, columns.d.dr, columns.t.shape
        self.analog = self.shape.estimator == "analog"
        self.redirects = self.shape.redirects != (0,)
        self.random_entry = settings.source.kind == "diffuse"
        one = columns.one
        self.capture = one(settings.capture_weight)
        self.max_steps = one(settings.max_steps, self.d.UInt32)
        self.half_width = None if settings.half_width_mm is None else one(settings.half_width_mm)
        n0, n1 = columns.t.index[0], columns.t.index[1]
        cosine = float(np.cos(settings.source.angle_rad))
        inside = refracted_cosine(n0, n1, np.full_like(n0, cosine))
        self.entry_mu = columns.each(inside)
        self.entry_ux = columns.each(n0 / n1 * np.sin(settings.source.angle_rad) * (inside > 0))
        self.entry_weight = columns.each(1.0 - fresnel(n0, n1, np.full_like(n0, cosine)))
        self.entry_eta = columns.each(n0 / n1)
        self.entry_contrast = columns.each((1.0 - n0 / n1) * (1.0 + n0 / n1))
        self.beam = one(max(settings.source.reach_mm, 0.0))

    def enter(self, stream: Any) -> Photon:
        """A new photon in every lane, just below the surface."""
        d, dr, source = self.d, self.dr, self.s.source
        zero = dr.zeros(d.Float, self.c.lanes)
        if source.kind == "diffuse":
            cosine = dr.sqrt(1.0 - random.uniform(d, stream.next_uint32()))
            r, mu = events.fresnel(d, self.entry_eta, self.entry_contrast, cosine)
            weight = 1.0 - r
            across: Any = ()
            if self.s.space:
                c, s = events.turn(d, random.uniform(d, stream.next_uint32()))
                sine = dr.sqrt(dr.maximum(1.0 - mu * mu, 0.0))
                across = (sine * c, sine * s)
        else:
            mu, weight = self.entry_mu + zero, self.entry_weight + zero
            across = (self.entry_ux + zero, dr.zeros(d.Float, self.c.lanes)) if self.s.space else ()
        place: Any = (dr.zeros(d.Float, self.c.lanes), dr.zeros(d.Float, self.c.lanes)) if self.s.space else ()
        if source.extended and self.s.space:
            u, v = random.uniform(d, stream.next_uint32()), random.uniform(d, stream.next_uint32())
            if source.square_half_width_mm:
                place = (self.beam * (2.0 * u - 1.0), self.beam * (2.0 * v - 1.0))
            else:
                c, s = events.turn(d, v)
                r = self.beam * dr.sqrt(u)
                place = (r * c, r * s)
        layer, steps = dr.zeros(d.UInt32, self.c.lanes), dr.zeros(d.UInt32, self.c.lanes)
        return Photon(layer, dr.zeros(d.Float, self.c.lanes), mu, across, place, weight, steps)

    def body(self, stream: Any, left: Any, p: Photon, entered: Any, states: Any) -> Any:
        """One step of every lane: to the next collision or the next interface, whichever is nearer."""
        d, dr = self.d, self.dr
        inside = self._layers(p.layer)
        flight = self._flight(stream, p, inside)
        polar_bits, azimuth_bits = stream.next_uint32(), stream.next_uint32()
        u = random.uniform(d, polar_bits)
        hit = self._collided(stream, p, inside, flight, u, azimuth_bits)
        face = self._interface(p, inside, flight, u)
        step, end = self._told(p, inside, flight, hit, face, entered, polar_bits)
        states = tuple(o.end(d, o.step(d, s, step), end) for o, s in zip(self.observers, states, strict=True))
        moved = self._moved(p, inside, flight, hit, face, end)

        fresh = self.enter(stream)
        choose = partial(dr.select, end.done)
        photon = Photon(
            choose(0, moved.layer),
            choose(0.0, moved.z),
            choose(fresh.mu, moved.mu),
            tuple(choose(a, b) for a, b in zip(fresh.across, moved.across, strict=True)),
            tuple(choose(a, b) for a, b in zip(fresh.place, moved.place, strict=True)),
            choose(fresh.weight, moved.weight),
            choose(0, moved.steps),
        )
        if self.random_entry:
            entered = choose(fresh.weight, entered)
        return stream, left - dr.select(end.done, d.UInt32(1), d.UInt32(0)), photon, entered, states

    def _flight(self, stream: Any, p: Photon, inside: Sequence[Any]) -> FlightStep:
        """How far the photon goes, and what ends it."""
        dr = self.dr
        depth = self._pick(inside, self.c.thickness)
        free, winner = self._free_path(stream, inside)
        up = p.mu < 0.0
        rest = dr.maximum(dr.select(up, p.z, depth - p.z), 0.0)
        reach = rest * dr.rcp(dr.maximum(dr.abs(p.mu), _TINY))
        met = free < reach
        path = dr.minimum(dr.minimum(free, reach), _FAR)
        place, side = p.place, None
        if place != ():
            place = (dr.fma(p.across[0], path, place[0]), dr.fma(p.across[1], path, place[1]))
        if self.half_width is not None:
            # The sample is convex: a step that starts inside has left it just if it ends outside.
            side = dr.maximum(dr.abs(place[0]), dr.abs(place[1])) > self.half_width
            met &= ~side
            path = dr.select(side, dr.minimum(path, self._to_side(p)), path)
        return FlightStep(up, depth, free, winner, met, path, place, side)

    def _collided(
        self, stream: Any, p: Photon, inside: Sequence[Any], flight: FlightStep, u: Any, azimuth_bits: Any
    ) -> CollisionResult:
        """What a collision at the flight's end makes of the photon."""
        target = self._target(stream, inside, flight.winner, flight.free)
        mu, across, azimuth, sign = self._turned(p, target, u, azimuth_bits)
        weight, absorbed, loss = self._survival(stream, p.weight, target, flight.free, azimuth, sign)
        return CollisionResult(mu, across, weight, absorbed, loss)

    def _told(
        self,
        p: Photon,
        inside: tuple[Any, ...],
        flight: FlightStep,
        hit: CollisionResult,
        face: InterfaceResult,
        entered: Any,
        bits: Any,
    ) -> tuple[Step, End]:
        """What the observers hear of the step, and of the photons that end with it."""
        d, dr = self.d, self.dr
        met, side, place = flight.met, flight.side, flight.place
        out_up = face.cross & flight.up & inside[0]
        out_down = face.cross & ~flight.up & inside[-1]
        weight = dr.select(met, hit.weight, p.weight)
        dead = met & (weight == 0.0)
        ended = out_up | out_down | dead if side is None else out_up | out_down | dead | side
        unfinished = (p.steps >= self.max_steps) & ~ended
        stopped = unfinished
        if self.redirects:
            stopped = stopped | (met & ~ended & (dr.abs(weight) < NEGLIGIBLE))
        culled, weight, balance = roulette.play(dr, p.steps, bits, weight, ~ended & ~stopped)
        balance = dr.select(stopped, weight, balance)
        taken = dr.select(met, hit.loss, 0.0) if self.redirects else None
        step = Step(inside, flight.path, met, dr.select(met, hit.absorbed, 0.0), taken)
        bend = 1.0 if face.eta is None else dr.select(face.cross, face.eta, 1.0)
        end = End(
            done=ended | stopped | culled,
            up=out_up,
            down=out_down,
            side=d.Bool(False) if side is None else side,
            stopped=stopped,
            unfinished=unfinished,
            culled=culled,
            balance=balance,
            weight=weight,
            entered=entered if self.random_entry else None,
            cosine=face.cosine,
            radius=dr.sqrt(place[0] * place[0] + place[1] * place[1]) if place != () else None,
            wavelength=self.c.wavelength,
            across=tuple(old * bend for old in p.across),
        )
        return step, end

    def _moved(
        self,
        p: Photon,
        inside: Sequence[Any],
        flight: FlightStep,
        hit: CollisionResult,
        face: InterfaceResult,
        end: End,
    ) -> Photon:
        """Where the photon stands now; an interface leaves it at the top or the bottom of a layer."""
        dr = self.dr
        met, up, cross = flight.met, flight.up, face.cross
        above = dr.select(up, self._pick(inside, self.c.above), 0.0)
        at_edge = dr.select(cross, above, dr.select(up, 0.0, flight.depth))
        return Photon(
            layer=dr.select(cross, dr.select(up, p.layer - 1, p.layer + 1), p.layer),
            z=dr.select(met, dr.fma(p.mu, flight.free, p.z), at_edge),
            mu=dr.select(met, hit.mu, dr.select(cross, face.mu, -p.mu)),
            across=tuple(dr.select(met, new, old) for new, old in zip(hit.across, end.across, strict=True)),
            place=flight.place,
            weight=end.weight,
            steps=p.steps + 1,
        )

    def _to_side(self, p: Photon) -> Any:
        """Distance to the nearer side along the photon's direction."""
        dr, half = self.dr, self.half_width
        away = [
            dr.fma(-dr.sign(u), x, half) * dr.rcp(dr.maximum(dr.abs(u), _TINY))
            for x, u in zip(p.place, p.across, strict=True)
        ]
        return dr.minimum(away[0], away[1])

    def _layers(self, layer: Any) -> tuple[Any, ...]:
        if self.shape.layers == 1:
            return (self.d.Bool(True),)
        return tuple(layer == k for k in range(self.shape.layers))

    def _pick(self, inside: Sequence[Any], values: Sequence[Any]) -> Any:
        return reduce(lambda found, k: self.dr.select(inside[k], values[k], found), range(1, len(values)), values[0])

    def _free_path(self, stream: Any, inside: Sequence[Any]) -> tuple[Any, Any]:
        """Distance to the next collision in mm, and in the analog walk whose draw won."""
        d, dr = self.d, self.dr
        best = random.exponential(d, stream.next_uint32()) * self._pick(inside, [x[0] for x in self.c.mfp])
        winner = d.UInt32(0)
        if self.analog:
            for e in range(1, self.shape.ways):
                mfp = self._pick(inside, [x[e] for x in self.c.mfp])
                drawn = random.exponential(d, stream.next_uint32()) * mfp
                nearer = drawn < best
                best, winner = dr.select(nearer, drawn, best), dr.select(nearer, d.UInt32(e), winner)
        return best, winner

    def _target(self, stream: Any, inside: Sequence[Any], winner: Any, free: Any) -> CollisionTarget:
        """The element met, or the way of scattering chosen by its share of what survives."""
        d, dr, c, count = self.d, self.dr, self.c, self.shape.ways

        def chosen(columns: Sequence[Sequence[Any]]) -> Any:
            value = self._pick(inside, columns[0])
            for k in range(1, count):
                value = dr.select(winner == k, self._pick(inside, columns[k]), value)
            return value

        survive, loss = None, None if self.analog else self._pick(inside, c.loss[0])
        if not self.analog and count > 1:
            shares = [self._pick(inside, x) for x in c.survive]
            if self.shape.short:
                for k, x in enumerate(c.below):
                    long = free >= self._pick(inside, x)
                    loss = loss + dr.select(long, 0.0, shares[k])
                    shares[k] = dr.select(long, shares[k], 0.0)
            survive = sum(shares[1:], shares[0])
            left = random.uniform(d, stream.next_uint32()) * survive
            winner, passed = d.UInt32(0), shares[0]
            for k in range(1, count):
                winner = dr.select(left >= passed, d.UInt32(k), winner)
                passed = passed + shares[k]
        survive = chosen(c.survive) if survive is None else survive
        loss = chosen(c.loss) if loss is None else loss
        columns = (c.below, c.kind, c.g, c.offset, c.focus, c.redirect)
        return CollisionTarget(survive, loss, *(chosen(x) for x in columns))

    def _turned(self, p: Photon, target: CollisionTarget, u: Any, bits: Any) -> tuple[Any, Any, Any, Any]:
        """New direction, the cosine of its azimuth in the sample's frame, and the sign a drawn factor carries."""
        d, dr, t = self.d, self.dr, self.c.t
        isotropic = self.shape.kinds == (ISOTROPIC,)
        w = events.polar(d, t, self.c.table, target.kind, target.g, target.offset, u)
        phi = random.uniform(d, bits)
        focused = self.redirects and not self.analog and not self.shape.steered
        if not self.s.space:
            # Only the analog walk weighs by an azimuth here; the other has its mean.
            azimuth = events.cosine_of_turn(d, phi) if not isotropic or (self.redirects and self.analog) else None
            mu = 1.0 - w if isotropic else events.tilt(d, p.mu, w, azimuth)
            return mu, (), azimuth, None
        cosine, sine = events.turn(d, phi)
        sign = None
        if focused:
            # Density ∝ |cos θ|: sin θ is uniform. The lowest bit is not part of the 24 used above.
            across = 2.0 * phi - 1.0
            along = dr.sqrt(dr.maximum((1.0 - across) * (1.0 + across), 0.0))
            back = (bits & 1) == 0
            if 3 in self.shape.redirects:
                back &= target.redirect != 3
            drawn = dr.select(back, -along, along)
            plain = target.redirect == 0
            cosine, sine = dr.select(plain, cosine, drawn), dr.select(plain, sine, across)
            if 2 in self.shape.redirects:
                sign = dr.select((target.redirect == 2) & back, d.Float(-1.0), d.Float(1.0))
        if isotropic:
            flat = dr.sqrt(dr.maximum(w * (2.0 - w), 0.0))
            return 1.0 - w, (flat * cosine, flat * sine), cosine, sign
        x, y, z = events.rotate(d, (*p.across, p.mu), w, cosine, sine)
        azimuth = x * dr.rsqrt(dr.maximum(x * x + y * y, _TINY)) if self.redirects else None
        return dr.clip(z, -1.0, 1.0), (x, y), azimuth, sign

    def _survival(
        self, stream: Any, before: Any, target: CollisionTarget, free: Any, azimuth: Any, sign: Any
    ) -> tuple[Any, Any, Any]:
        """Weight after a collision, what was absorbed, and what the redirect factor took."""
        d, dr = self.d, self.dr
        chance, loss = target.survive, target.loss
        if self.shape.short and (self.analog or self.shape.ways == 1):
            long = free >= target.below
            chance, loss = dr.select(long, chance, 0.0), dr.select(long, loss, 1.0)
        drawn = random.fine_uniform(d, stream.next_uint32())
        focus = target.focus if self.redirects and not self.analog and not self.shape.steered else None
        if self.analog:
            kept = dr.select(drawn < loss, 0.0, before)
            absorbed = before - kept
        elif focus is None:
            # Below the capture weight a photon survives by chance, whole: unbiased, and energy stays exact.
            whole = dr.abs(before) < self.capture
            lump = dr.select(whole, d.Float(1.0), LUMP)
            by_chance = dr.select(drawn * lump < loss, lump, 0.0)
            kept = dr.select(whole | (loss < LUMP), dr.fma(-before, by_chance, before), before * chance)
            absorbed = before - kept
        else:
            both = chance * focus
            whole = dr.abs(before) < self.capture
            lives = drawn < both
            kept = dr.select(whole, dr.select(lives, before, 0.0), before * both)
            taken = before * loss
            absorbed = dr.select(whole, dr.select(lives, 0.0, taken / (1.0 - both)), taken)
            if sign is not None:
                kept = kept * sign
        if self.redirects and (self.analog or self.shape.steered):
            kept = kept * self._factor(target.redirect, azimuth)
        return kept, absorbed, before - absorbed - kept if self.redirects else None

    def _factor(self, code: Any, azimuth: Any) -> Any:
        """Algorithm 2's factor from the cosine of the azimuth."""
        dr = self.dr
        values = {0: self.d.Float(1.0), 1: dr.abs(azimuth), 2: azimuth, 3: dr.maximum(azimuth, 0.0)}
        found = None
        for k in self.shape.redirects:
            found = values[k] if found is None else dr.select(code == k, values[k], found)
        return found

    def _interface(self, p: Photon, inside: Sequence[Any], flight: FlightStep, u: Any) -> InterfaceResult:
        """What happens where the flight ends at an interface."""
        d, dr, c, up = self.d, self.dr, self.c, flight.up
        at_edge = ~flight.met if flight.side is None else ~flight.met & ~flight.side
        if not self.shape.fresnel:
            return InterfaceResult(d.Bool(True) & at_edge, p.mu, dr.abs(p.mu), None)
        eta, contrast = (
            dr.select(up, self._pick(inside, x["up"]), self._pick(inside, x["down"])) for x in (c.eta, c.contrast)
        )
        r, behind = events.fresnel(d, eta, contrast, dr.abs(p.mu))
        return InterfaceResult((u >= r) & at_edge, dr.select(up, -behind, behind), behind, eta)


def trace(
    columns: Columns, settings: Settings, observers: Sequence[Observer], samples: int, seed: int, batch: int
) -> list[Any]:
    """Walk `samples` photons at each wavelength, shared out among its lanes, and return the observers' last states."""
    d, dr = columns.d, columns.d.dr
    walk = _Walk(columns, settings, observers)
    stream = random.streams(d, columns.lanes, seed, batch)
    photon = walk.enter(stream)
    share, rest = divmod(samples, columns.per_wavelength)
    quota = dr.opaque(d.UInt32, share) + dr.select(columns.rank < dr.opaque(d.UInt32, rest), d.UInt32(1), d.UInt32(0))
    state = (
        stream,
        quota,
        photon,
        photon.weight if walk.random_entry else (),
        tuple(o.start(d, columns.lanes) for o in observers),
    )
    state = dr.while_loop(state, lambda stream, left, *_: left > 0, walk.body, label="walk", mode="symbolic")
    last = state[-1]
    dr.eval(last)
    dr.sync_thread()
    return list(last)
