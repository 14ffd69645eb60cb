"""A free flight inside a body: through layers told by their depth, as far as the surface may be taken for flat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from livlab.model.tracer.body import Body
from livlab.model.tracer.field import Field
from livlab.model.tracer.medium import Medium
from livlab.model.tracer.state import PathState, Place

FAR = 1e30
BEND = 0.02
"""Part of the layers' thickness by which the surface may leave its tangent plane within a patch."""

TRY = 1.9
"""A flight that the surface's flatness would let be proved, as part of twice the clearance over 1 − slope."""

STEEP = 0.1
"""Cosine with the inward normal from which on a flight of a patch's length does not count as grazing."""


@dataclass
class Flight:
    """Where a free flight leads if no surface is in the way.

    Attributes
    ----------
    reach
        Its length.
    collides, layer, within
        Whether it ends in a collision, in which layer, and how far it then was in that layer since its last draw.
    barrier
        Whether it ends at an interface between layers, told by depth.
    spans
        Where the flight enters and leaves each layer.
    """

    reach: Any
    collides: Any
    layer: Any
    within: Any
    barrier: Any
    spans: Sequence[tuple[Any, Any]]
    slope: Any


class Flights:
    """Free flights in one body."""

    def __init__(self, medium: Medium, body: Body, field: Field | None, size: float) -> None:
        self.medium, self.body = medium, body
        self.field = None if body.nested else field
        self.dr, self.mi = medium.dr, medium.mi
        m = medium.m
        self.layered = not body.nested and m.layers > 1
        thickness = medium.inner
        patch = (
            body.patch_mm / body.mm_per_unit
            if body.patch_mm is not None
            else (2.0 * 0.1 * size * BEND * thickness) ** 0.5
            if thickness > 0
            else size
        )
        one = partial(self.dr.opaque, self.mi.Float)
        self.patch, self.thickness = one(float(patch)), one(float(thickness))
        self.slack = one(float((field.slack if field else 0.0) + BEND * thickness))

    def free(self, s: PathState, tau: Any) -> tuple[Any, Any]:
        """Layer and free path where a region is one layer."""
        dr, mi, medium = self.dr, self.mi, self.medium
        layer = s.medium - 1 if medium.m.layers > 1 else mi.UInt32(0)
        rates = medium.packet(medium.rates, s.hero, medium.stride)
        rate = medium.pick(layer, rates[: medium.m.layers])
        return layer, dr.minimum(tau * dr.rcp(dr.maximum(rate, 1e-30)), FAR)

    def fly(self, s: PathState) -> Flight:
        """Follow a ray until its optical depth is spent, an interface comes, or what is known of the depth ends."""
        dr, mi, medium = self.dr, self.mi, self.medium
        m, place = medium.m, s.place
        if not self.layered:
            layer, free = self.free(s, s.tau)
            collides = free < FAR
            inf = mi.Float(FAR)
            spans = [
                (dr.select(layer == k, 0.0, inf), inf) if m.layers > 1 else (mi.Float(0.0), inf)
                for k in range(m.layers)
            ]
            within = free + place.since if medium.short else free
            return Flight(free, collides, layer, within, mi.Bool(False), spans, mi.Float(0.0))
        region = s.medium - 1
        slope = dr.dot(s.d, place.inward)
        down = slope > 0.0
        # Of a flight that is level to the last bit, too, the sign must be that of `down`.
        inverse = dr.select(down, 1.0, -1.0) * dr.rcp(dr.maximum(dr.abs(slope), 1e-12))
        bound = dr.select(
            down,
            medium.pick(region, medium.region_bottom),
            medium.pick(region, [mi.Float(-FAR), *medium.region_top[1:]]),
        )
        to_barrier = dr.maximum((bound - place.depth) * inverse, 0.0)
        # Deep inside a longer flight is tried, which the depth at its end may prove: see `prove`.
        deep = place.clear - self.thickness
        tried = dr.select(deep > self.patch, TRY * deep * dr.rcp(dr.maximum(1.0 - slope, 0.2)), 0.0)
        horizon = dr.maximum(place.trust, tried)
        limit = dr.minimum(horizon, to_barrier)
        rates = medium.packet(medium.rates, s.hero, medium.stride)
        spans, depths = [], []
        for k in range(m.layers):
            a, b = ((medium.top[j] - place.depth) * inverse for j in (k, k + 1))
            enter = dr.maximum(dr.minimum(a, b), 0.0)
            leave = dr.maximum(a, b)
            spans.append((enter, leave))
            depths.append(rates[k] * dr.maximum(dr.minimum(leave, limit) - enter, 0.0))
        before, total = [], mi.Float(0.0)
        for x in depths:
            before.append(total)
            total = total + x
        collides = s.tau < total
        layer, start, left, rate = mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(1.0)
        for k, x in enumerate(depths):
            first = dr.select(down, before[k], total - before[k] - x)
            here = (s.tau >= first) & (x > 0.0)
            here &= s.tau < first + x
            layer = dr.select(here, mi.UInt32(k), layer)
            start = dr.select(here, spans[k][0], start)
            left = dr.select(here, s.tau - first, left)
            rate = dr.select(here, rates[k], rate)
        path = left * dr.rcp(rate)
        reach = dr.select(collides, dr.minimum(start + path, limit), limit)
        within = dr.select(start > 0.0, path, path + place.since) if medium.short else path
        barrier = ~collides & (to_barrier <= horizon)
        return Flight(reach, collides, layer, within, barrier, spans, slope)

    def settle(self, s: PathState, flight: Flight, walks: Any) -> tuple[Any, Any, Any, Any, Place]:
        """What comes of a flight: whether it holds, needs a ray cast, or ends outside; how far it goes, and the place.

        The points within its clearance of either end of a flight are inside; if the two together are longer than the
        flight, so is all of it.
        """
        dr, mi, place = self.dr, self.mi, s.place
        if self.field is None:
            return mi.Bool(False), walks, mi.Bool(False), mi.Float(0.0), place
        if self.layered:
            deep = place.clear - self.thickness
            far = walks & (flight.reach > place.trust)
            looks = far | (walks & (flight.reach >= place.trust))
            casts = walks & ~far & (place.trust > 0.0) & self.may_leave(place, flight)
        else:
            deep = place.clear
            blind = place.trust <= 0.0
            far = walks & ~blind & (flight.reach > deep)
            looks = far | (walks & blind)
            casts = mi.Bool(False)
        looks &= ~casts
        end = flight.reach if self.layered else dr.select(blind, 0.0, flight.reach)
        depth, inward = self.field.look(dr.fma(end, s.d, s.p), looks)
        clear = depth - self.slack
        proved = dr.maximum(deep, 0.0) + clear - self.thickness >= flight.reach
        if self.layered:
            holds = walks & ~casts & (~far | proved)
            path = dr.select(holds, flight.reach, dr.maximum(dr.minimum(place.trust, flight.reach), 0.0))
        else:
            # What the grid takes to be outside may be inside by a sharp edge: a ray tells.
            casts = (far & ~proved) | (looks & blind & (depth < -self.slack) & (dr.dot(s.d, inward) < 0.0))
            holds = walks & ~blind & ~casts
            path = dr.select(holds, flight.reach, 0.0)
        path = dr.select(walks & ~casts, path, 0.0)
        # Deep inside nothing is near; by the surface the layers lie flat as far as a patch goes.
        trust = dr.maximum(clear - self.thickness, self.patch) if self.layered else mi.Float(FAR)
        known = looks & (holds | (end <= 0.0)) & ~casts
        old = self.moved(place, flight, path)
        choose = partial(dr.select, known)
        lost = known & (depth < -self.slack) & (dr.dot(s.d, inward) < 0.0)
        made = Place(
            choose(dr.maximum(depth, 0.0), old.depth),
            choose(inward, old.inward),
            choose(trust, old.trust),
            choose(clear, old.clear),
            old.since,
        )
        return holds, casts, lost, path, made

    def lengths(self, flight: Flight, path: Any) -> list[Any]:
        """Path in each layer when the flight ends after `path`."""
        dr = self.dr
        return [dr.maximum(dr.minimum(leave, path) - enter, 0.0) for enter, leave in flight.spans]

    def may_leave(self, place: Place, flight: Flight) -> Any:
        """Whether the surface may lie in the way of a flight by the surface."""
        # Within a patch the plane tells the distance better than the last look less the path since.
        flat = self.dr.select(place.depth < self.thickness + self.patch, place.depth - self.slack, 0.0)
        # What heads inwards by more than a few degrees does not leave within a patch.
        inwards = (flight.slope > STEEP) & (flight.reach <= self.patch)
        return (flight.reach > self.dr.maximum(place.clear, flat)) & ~inwards

    def moved(self, place: Place, flight: Flight, path: Any) -> Place:
        """Keep account of a step."""
        since = place.since + path if self.medium.short else ()
        if self.field is None:
            return Place(inward=place.inward, since=since)
        depth = place.depth + flight.slope * path if self.layered else place.depth
        return Place(depth, place.inward, place.trust - path, place.clear - path, since)
