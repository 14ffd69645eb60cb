"""A free flight inside a body: through layers told by their depth, as far as the surface may be taken for flat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from livlab.model.tracer.body import Body
from livlab.model.tracer.field import Field
from livlab.model.tracer.medium import Medium
from livlab.model.tracer.state import Place, State

FAR = 1e30
BEND = 0.02
"""Part of the layers' thickness by which the surface may leave its tangent plane within a patch."""


@dataclass
class Flight:
    """Where a free flight leads if no surface is in the way.

    Attributes
    ----------
    reach
        Its length.
    meets, layer, within
        Whether it ends in a meeting, in which layer, and how far it then was in that layer since its last draw.
    barrier
        Whether it ends at an interface between layers, told by depth.
    spans
        Where the flight enters and leaves each layer.
    """

    reach: Any
    meets: Any
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

    def free(self, s: State, tau: Any) -> tuple[Any, Any]:
        """Layer and free path where a region is one layer."""
        dr, mi, medium = self.dr, self.mi, self.medium
        layer = s.medium - 1 if medium.m.layers > 1 else mi.UInt32(0)
        rates = medium.packet(medium.rates, s.hero, medium.stride)
        rate = medium.pick(layer, rates[: medium.m.layers])
        return layer, dr.minimum(tau * dr.rcp(dr.maximum(rate, 1e-30)), FAR)

    def refresh(self, s: State, tau: Any, inside: Any) -> tuple[Place, Any]:
        """Look the depth up where the last look no longer holds; tells also where the path has left the body."""
        dr, mi = self.dr, self.mi
        place = s.place
        if self.field is None:
            return place, mi.Bool(False)
        stale = inside & (place.trust <= 0.0 if self.layered else place.clear < self.free(s, tau)[1])
        depth, inward = self.field.look(s.p, stale)
        lost = stale & (depth < -self.slack) & (dr.dot(s.d, inward) < 0.0)
        clear = depth - self.slack
        # Deep inside nothing is near; by the surface the layers lie flat as far as a patch goes.
        trust = dr.maximum(clear - self.thickness, self.patch) if self.layered else mi.Float(FAR)
        choose = partial(dr.select, stale)
        found = Place(
            choose(dr.maximum(depth, 0.0), place.depth),
            choose(inward, place.inward),
            choose(trust, place.trust),
            choose(clear, place.clear),
            place.since,
        )
        return found, lost

    def fly(self, s: State, place: Place, tau: Any) -> Flight:
        """Follow a ray until its optical depth is spent, an interface is met, or the look-up ends."""
        dr, mi, medium = self.dr, self.mi, self.medium
        m = medium.m
        if not self.layered:
            layer, free = self.free(s, tau)
            meets = free < FAR
            inf = mi.Float(FAR)
            spans = [
                (dr.select(layer == k, 0.0, inf), inf) if m.layers > 1 else (mi.Float(0.0), inf)
                for k in range(m.layers)
            ]
            within = free + place.since if medium.short else free
            return Flight(free, meets, layer, within, mi.Bool(False), spans, mi.Float(0.0))
        region = s.medium - 1
        slope = dr.dot(s.d, place.inward)
        down = slope > 0.0
        inverse = dr.rcp(dr.mulsign(dr.maximum(dr.abs(slope), 1e-12), slope))
        bound = dr.select(
            down,
            medium.pick(region, medium.region_bottom),
            medium.pick(region, [mi.Float(-FAR), *medium.region_top[1:]]),
        )
        to_barrier = dr.maximum((bound - place.depth) * inverse, 0.0)
        limit = dr.minimum(place.trust, to_barrier)
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
        meets = tau < total
        layer, start, left, rate = mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(1.0)
        for k, x in enumerate(depths):
            first = dr.select(down, before[k], total - before[k] - x)
            here = (tau >= first) & (x > 0.0)
            here &= tau < first + x
            layer = dr.select(here, mi.UInt32(k), layer)
            start = dr.select(here, spans[k][0], start)
            left = dr.select(here, tau - first, left)
            rate = dr.select(here, rates[k], rate)
        path = left * dr.rcp(rate)
        reach = dr.select(meets, dr.minimum(start + path, limit), limit)
        within = dr.select(start > 0.0, path, path + place.since) if medium.short else path
        barrier = ~meets & (to_barrier <= place.trust)
        return Flight(reach, meets, layer, within, barrier, spans, slope)

    def lengths(self, flight: Flight, path: Any) -> list[Any]:
        """Path in each layer when the flight ends after `path`."""
        dr = self.dr
        return [dr.maximum(dr.minimum(leave, path) - enter, 0.0) for enter, leave in flight.spans]

    def clear(self, place: Place) -> Any:
        """Path within which no surface can be."""
        dr = self.dr
        if self.field is None:
            return self.mi.Float(0.0)
        if not self.layered:
            return place.clear
        # Within a patch the plane tells the distance better than the last look-up less the path since.
        flat = dr.select(place.depth < self.thickness + self.patch, place.depth - self.slack, 0.0)
        return dr.maximum(place.clear, flat)

    def moved(self, place: Place, flight: Flight, path: Any) -> Place:
        """Keep account of a step."""
        since = place.since + path if self.medium.short else ()
        if self.field is None:
            return Place((), place.inward, (), (), since)
        depth = place.depth + flight.slope * path if self.layered else place.depth
        return Place(depth, place.inward, place.trust - path, place.clear - path, since)
