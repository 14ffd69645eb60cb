"""What happens at an interface: reflection or refraction, and how the path's sums take it."""

from __future__ import annotations

from typing import Any

from livlab.model.tracer.context import Context
from livlab.model.tracer.state import WALK, PathState
from livlab.model.tracer.surface import Hit

MIRRORED = 0.2
"""Share of the camera's rays that the first surface mirrors."""


def cross_layers(context: Context, s: PathState, barrier: Any) -> PathState:
    """Reflect or refract at an interface between layers that the depth tells."""
    dr, mi, m = context.dr, context.mi, context.medium
    assert m is not None
    place = s.place
    up = dr.dot(s.d, place.inward) < 0.0
    interface = dr.select(up, s.medium - 1, s.medium)
    eta = _ratio(context, s, interface, up, barrier)
    cosine, bounced, bent = _turned(dr, s.d, -place.inward, eta)
    row = m.fresnel_row(interface, up, cosine)
    reflectance = dr.gather(mi.Float, m.reflectance, row * m.m.padded + s.hero, barrier)
    reflects = context.uniform(s) < reflectance
    s.d = dr.select(barrier, dr.select(reflects, bounced, bent), s.d)
    _record(context, s, row, reflects, barrier, interface)
    s.medium = dr.select(barrier & ~reflects, dr.select(up, interface, interface + 1), s.medium)
    s.covered = dr.select(barrier & reflects, 0.0, s.covered)
    place.depth = dr.select(barrier, m.pick(interface, m.region_top), place.depth)
    if m.short:
        place.since = dr.select(barrier, 0.0, place.since)
    s.pending = dr.select(barrier, WALK, s.pending)
    return s


def cross(context: Context, s: PathState, hit: Hit, enters: Any, exits: Any, lost: Any) -> PathState:
    """Reflect or refract at a surface that a ray has hit; or leave where a path finds itself outside."""
    dr, mi, m, place = context.dr, context.mi, context.medium, s.place
    assert m is not None and context.flights is not None
    throughput = s.throughput
    exits = exits | lost
    any_ = enters | exits
    interface, upwards = mi.UInt32(0), exits
    if context.interfaces > 1:
        interface = dr.select(lost, 0, hit.interface)
        upwards = exits & (~hit.outward | lost)
    # Where the normal was last looked up may be far, unless layers asked for it.
    out = -place.inward if context.flights.layered else s.d
    normal = dr.select(lost, out, hit.normal)
    eta = _ratio(context, s, interface, upwards, any_)
    # A smoothed normal may send light to the wrong side of the surface: there the facet's own is taken.
    _, bounced, bent = _turned(dr, s.d, normal, eta)
    before = dr.dot(s.d, hit.facet)
    wrong = (dr.dot(bounced, hit.facet) * before >= 0.0) | (dr.dot(bent, hit.facet) * before <= 0.0)
    normal = dr.select(any_ & ~lost & wrong, hit.facet, normal)
    cosine, bounced, bent = _turned(dr, s.d, normal, eta)
    row = m.fresnel_row(interface, upwards, cosine)
    reflectance = dr.gather(mi.Float, m.reflectance, row * m.m.padded + s.hero, any_)
    # Of the camera's own rays more are mirrored than Fresnel says, and count less: highlights are small and bright.
    first = enters & s.fresh
    mirrored = dr.gather(mi.Float, m.reflectance, row * m.m.padded, first)
    if m.m.refracts[0]:
        mirrored = dr.maximum(mirrored, MIRRORED)
    u = context.uniform(s)
    reflects = u < dr.select(first, mirrored, reflectance)
    s.d = dr.select(any_, dr.select(reflects, bounced, bent), s.d)
    chance = dr.rcp(dr.select(reflects, mirrored, 1.0 - mirrored))
    if m.first:
        throughput.first = dr.select(first, 2 * row + dr.select(reflects, mi.UInt32(0), 1), throughput.first)
    else:
        chance = chance * dr.select(reflects, reflectance, 1.0 - reflectance)
    throughput.common = dr.select(first, throughput.common * chance, throughput.common)
    _record(context, s, row, reflects, any_ & ~first, interface)
    through = any_ & ~reflects
    after = dr.select(upwards, interface, interface + 1)
    s.medium = dr.select(through, after, s.medium)
    s.covered = dr.select((any_ & reflects) | enters, 0.0, s.covered)
    if context.others:
        s.bounce.pdf = dr.select(any_, 0.0, s.bounce.pdf)
    if context.field:
        # At the surface its depth is known: nothing to look up.
        place.depth = dr.select(any_, 0.0, place.depth)
        place.inward = dr.select(any_, -normal, place.inward)
        # What is outside by rounding and mirrored there would be outside again.
        s.p = dr.select(lost & reflects, dr.fma(context.nudge(s.p), place.inward, s.p), s.p)
        place.trust = dr.select(any_, context.flights.patch, place.trust)
        place.clear = dr.select(any_, 0.0, place.clear)
    elif context.next_event:
        place.inward = dr.select(any_ & ((interface == 0) | ~upwards), -normal, place.inward)
    if m.short:
        place.since = dr.select(any_, 0.0, place.since)
    return s


def _ratio(context: Context, s: PathState, interface: Any, upwards: Any, active: Any) -> Any:
    """Index before an interface over that behind it."""
    dr, mi, m = context.dr, context.mi, context.medium
    assert m is not None
    above = dr.gather(mi.Float, m.index, interface * context.width + s.hero, active)
    below = dr.gather(mi.Float, m.index, (interface + 1) * context.width + s.hero, active)
    return dr.select(upwards, below * dr.rcp(above), above * dr.rcp(below))


def _record(context: Context, s: PathState, row: Any, reflects: Any, active: Any, interface: Any) -> None:
    """Add a choice of Fresnel's to the path's sums where its chance differs by wavelength."""
    dr, mi, m = context.dr, context.mi, context.medium
    assert m is not None
    if m.vector and any(m.m.dispersive):
        add = active & m.pick(interface, [mi.Bool(x) for x in m.m.dispersive])
        # Where nothing is crossed the row is none of the table's.
        found = m.packet(m.log_fresnel, 2 * row + dr.select(reflects, mi.UInt32(0), 1), m.m.padded, add)
        s.throughput.rows = [x + dr.select(add, r, 0.0) for x, r in zip(s.throughput.rows, found, strict=False)]


def _turned(dr: Any, d: Any, normal: Any, eta: Any) -> tuple[Any, Any, Any]:
    """Cosine with a normal of either side, and the direction after reflection and after refraction."""
    along = dr.dot(d, normal)
    cosine = dr.minimum(dr.abs(along), 1.0)
    facing = dr.mulsign(normal, -along)
    behind = dr.safe_sqrt(1.0 - eta * eta * (1.0 - cosine * cosine))
    return cosine, dr.fma(2.0 * cosine, facing, d), dr.normalize(eta * d + (eta * cosine - behind) * facing)
