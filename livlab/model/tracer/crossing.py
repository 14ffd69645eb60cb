"""What happens at an interface: reflection or refraction, and how the ledger takes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from livlab.model.tracer.state import Place, State

if TYPE_CHECKING:
    from livlab.model.tracer.kernel import Hit, Kernel

MIRRORED = 0.2
"""Share of the camera's rays that the first surface mirrors."""


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
    above = dr.gather(mi.Float, m.index, interface * kernel.width + s.hero, any_)
    below = dr.gather(mi.Float, m.index, (interface + 1) * kernel.width + s.hero, any_)
    eta = dr.select(upwards, below * dr.rcp(above), above * dr.rcp(below))
    # A smoothed normal may send light to the wrong side of the surface: there the facet's own is taken.
    _, bounced, bent = _turned(dr, s.d, normal, eta)
    before = dr.dot(s.d, hit.si.n)
    wrong = (dr.dot(bounced, hit.si.n) * before >= 0.0) | (dr.dot(bent, hit.si.n) * before <= 0.0)
    normal = dr.select((enters | exits) & ~lost & wrong, hit.si.n, normal)
    cosine, bounced, bent = _turned(dr, s.d, normal, eta)
    row = m.fresnel_row(interface, upwards, cosine)
    reflectance = dr.gather(mi.Float, m.reflectance, row * m.m.padded + s.hero, any_)
    # Of the camera's own rays more are mirrored than Fresnel says, and count less: highlights are small and bright.
    first = enters & s.fresh
    mirrored = dr.gather(mi.Float, m.reflectance, row * m.m.padded, first)
    if m.m.refracts[0]:
        mirrored = dr.maximum(mirrored, MIRRORED)
    reflects = u < dr.select(first, mirrored, reflectance)
    s.d = dr.select(any_, dr.select(reflects, bounced, bent), s.d)
    chance = dr.rcp(dr.select(reflects, mirrored, 1.0 - mirrored))
    if m.first:
        marked = row | dr.select(reflects, mi.UInt32(0), 1 << 31)
        ledger.first = dr.select(first, marked, ledger.first)
    else:
        chance = chance * dr.select(reflects, reflectance, 1.0 - reflectance)
    ledger.common = dr.select(first, ledger.common * chance, ledger.common)
    if m.vector and any(m.m.dispersive):
        found = m.packet(m.reflectance, row, m.m.padded)
        varies = m.pick(interface, [mi.Bool(x) for x in m.m.dispersive])
        add = any_ & ~first & varies
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
    elif kernel.peel is not None:
        place.inward = dr.select(enters | exits, -normal, place.inward)
    if m.short:
        place.since = dr.select(any_, 0.0, place.since)
    return place


def _turned(dr: Any, d: Any, normal: Any, eta: Any) -> tuple[Any, Any, Any]:
    """Cosine with a normal of either side, and the direction after reflection and after refraction."""
    along = dr.dot(d, normal)
    cosine = dr.minimum(dr.abs(along), 1.0)
    facing = dr.mulsign(normal, -along)
    behind = dr.safe_sqrt(1.0 - eta * eta * (1.0 - cosine * cosine))
    return cosine, dr.fma(2.0 * cosine, facing, d), dr.normalize(eta * d + (eta * cosine - behind) * facing)
