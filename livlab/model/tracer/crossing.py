"""What happens at an interface: reflection or refraction, and how the ledger takes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from livlab.model.tracer.state import Place, State

if TYPE_CHECKING:
    from livlab.model.tracer.kernel import Hit, Kernel


def cross(
    kernel: Kernel, s: State, place: Place, hit: Hit, enters: Any, exits: Any, lost: Any, barrier: Any, u: Any
) -> Place:
    """Reflect or refract at an interface."""
    dr, mi, m = kernel.dr, kernel.mi, kernel.medium
    assert m is not None and kernel.flights is not None
    ledger = s.ledger
    exits = exits | lost
    any_ = enters | exits | barrier
    if len(kernel.shapes) > 1:
        interface = hit.interface
        upwards = exits & ~hit.outward
    else:
        region = s.medium - 1
        up_inside = dr.dot(s.d, place.inward) < 0.0 if kernel.flights.layered else mi.Bool(False)
        interface = dr.select(barrier, dr.select(up_inside, region, region + 1), mi.UInt32(0))
        upwards = exits | (barrier & up_inside)
    normal = hit.normal
    out = -place.inward if kernel.flights.field is not None else s.d
    normal = dr.select(barrier | lost, out, normal)
    cosine = dr.minimum(dr.abs(dr.dot(s.d, normal)), 1.0)
    row = m.fresnel_row(interface, upwards, cosine)
    reflectance = dr.gather(mi.Float, m.reflectance, row * m.m.padded + s.hero, any_)
    above = dr.gather(mi.Float, m.index, interface * kernel.width + s.hero, any_)
    below = dr.gather(mi.Float, m.index, (interface + 1) * kernel.width + s.hero, any_)
    eta = dr.select(upwards, below * dr.rcp(above), above * dr.rcp(below))
    first = enters & s.fresh
    mirror = s.turn >= kernel.plan.samples
    split = first if kernel.plan.mirrored else mi.Bool(False)
    reflects = dr.select(split, mirror, u < reflectance)
    facing = dr.mulsign(normal, -dr.dot(s.d, normal))
    behind = dr.safe_sqrt(1.0 - eta * eta * (1.0 - cosine * cosine))
    bounced = dr.fma(2.0 * cosine, facing, s.d)
    bent = dr.normalize(eta * s.d + (eta * cosine - behind) * facing)
    # A smoothed normal may send light to the wrong side of the surface itself: then the surface's own decides.
    s.d = dr.select(any_, dr.select(reflects, bounced, bent), s.d)
    if kernel.plan.mirrored:
        # Both ways are followed, each by its own samples.
        share = kernel.plan.samples / kernel.plan.mirrored
        if m.first:
            chance = dr.select(mirror, mi.Float(share), 1.0)
            marked = row | dr.select(mirror, mi.UInt32(0), 1 << 31)
            ledger.first = dr.select(first, marked, ledger.first)
        else:
            chance = dr.select(mirror, reflectance * share, 1.0 - reflectance)
        ledger.common = dr.select(first, ledger.common * chance, ledger.common)
    if m.vector and any(m.m.dispersive):
        found = m.packet(m.reflectance, row, m.m.padded)
        varies = m.pick(interface, [mi.Bool(x) for x in m.m.dispersive])
        add = any_ & ~split & varies
        ledger.rows = [
            x + dr.select(add, dr.log(dr.maximum(dr.select(reflects, r, 1.0 - r), 1e-30)), 0.0)
            for x, r in zip(ledger.rows, found, strict=False)
        ]
    through = any_ & ~reflects
    after = dr.select(upwards, interface, interface + 1)
    s.medium = dr.select(through, after, s.medium)
    s.covered &= ~(any_ & reflects) & ~enters
    if kernel.flights.field is not None:
        at_surface = enters | exits
        place.depth = dr.select(at_surface, 0.0, place.depth)
        place.trust = dr.select(at_surface, 0.0, place.trust)
        place.clear = dr.select(at_surface, 0.0, place.clear)
        if kernel.flights.layered:
            told = m.pick(interface, m.region_top)
            place.depth = dr.select(barrier, told, place.depth)
    if m.short:
        place.since = dr.select(any_, 0.0, place.since)
    return place
