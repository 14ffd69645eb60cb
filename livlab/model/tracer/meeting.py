"""What happens at a meeting inside: absorption, scattering, and the light that reaches its place from lamps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from livlab.model.tracer.flight import Flight
from livlab.model.tracer.medium import HEAD
from livlab.model.tracer.state import Place, State
from livlab.model.transport import rng as random
from livlab.model.transport import walk_events as events

if TYPE_CHECKING:
    from livlab.model.tracer.kernel import Kernel


def meet(
    kernel: Kernel, s: State, place: Place, flight: Flight, meets: Any, seen: list[Any], film: Any
) -> tuple[Place, Any]:
    """Absorb or scatter; and add the light that was seen, or is asked for here, to the film."""
    dr, mi, d, m = kernel.dr, kernel.mi, kernel.d, kernel.medium
    assert m is not None
    ledger = s.ledger
    row = m.packet(m.meetings, flight.layer * kernel.width + s.hero, m.meeting_stride)
    albedo, below, base, base_short, lossy = row[:HEAD]
    code, g = row[HEAD + 1], row[HEAD + 2]
    if m.ways > 1:
        v = random.uniform(d, s.stream.next_uint32())
        for c in range(1, m.ways):
            later = v >= row[HEAD + 3 * (c - 1)]
            code = dr.select(later, row[HEAD + 3 * c + 1], code)
            g = dr.select(later, row[HEAD + 3 * c + 2], g)
    short = flight.within < below if m.short else mi.Bool(False)
    if m.tabled:
        base = dr.select(short, base_short, base)
    bits, azimuth = s.stream.next_uint32(), s.stream.next_uint32()
    closed = code < 0.0
    kind = mi.UInt32(dr.select(closed, -1.0 - code, 3.0))
    offset = mi.UInt32(dr.maximum(code, 0.0))
    w = events.polar(d, m.m.walk, m.table, kind, g, offset, random.uniform(d, bits))
    cosine, sine = events.turn(d, random.uniform(d, azimuth))
    turned = mi.Vector3f(*events.rotate(d, (s.d.x, s.d.y, s.d.z), w, cosine, sine))
    asks = meets & ~(short & (base < 0.0))
    light(kernel, film, s, place, flight, asks, (code, g, base), seen)
    # The first meeting in a layer that absorbs is survived by weight, all others by chance.
    drawn = random.fine_uniform(d, s.stream.next_uint32())
    chance = albedo
    if m.focused:
        focus = m.pick(flight.layer, m.focus)
        if kernel.analog:
            factor = m.factor(flight.layer, random.uniform(d, s.stream.next_uint32()))
            ledger.common = dr.select(meets, ledger.common * factor, ledger.common)
        else:
            chance = chance * focus
    if kernel.forces:
        forced = meets & (ledger.forced == m.m.layers) & (lossy > 0.0) & (albedo > 0.0)
        ledger.forced = dr.select(forced, flight.layer, ledger.forced)
        if m.focused:
            ledger.common = dr.select(forced, ledger.common * focus, ledger.common)
        chance = dr.select(forced, 1.0, chance)
    dead = meets & (drawn >= chance)
    if m.short:
        dead |= meets & short & (base < 0.0)
    lives = meets & ~dead
    s.d = dr.select(lives, turned, s.d)
    ledger.counts = [
        n + dr.select(lives & (flight.layer == k), mi.Float(1.0), 0.0)
        for n, k in zip(ledger.counts, m.counted, strict=True)
    ]
    if m.vector and m.tabled:
        found = m.packet(m.rows, mi.UInt32(dr.maximum(base, 0.0)) + mi.UInt32(m.cell(w)), m.m.padded)
        add = lives & (base >= 0.0)
        ledger.rows = [x + dr.select(add, y, 0.0) for x, y in zip(ledger.rows, found, strict=False)]
    if m.short:
        place.since = dr.select(meets, 0.0, place.since)
    s.covered = (s.covered & ~lives) | (lives & bool(kernel.lights.lamps))
    return place, dead


def light(
    kernel: Kernel,
    film: Any,
    s: State,
    place: Place,
    flight: Flight,
    asks: Any,
    way: tuple[Any, Any, Any],
    seen: list[Any],
) -> None:
    """Weigh what light was met, or reaches the place of a meeting from a lamp, at every wavelength."""
    dr, mi, m = kernel.dr, kernel.mi, kernel.medium
    assert m is not None
    zero = [mi.Float(0.0)] * kernel.width
    if kernel.peel is None:
        weight = m.weights(s.ledger, zero, None, zero)
        kernel.deposit(film, s, [s.ledger.common * w * x for w, x in zip(weight, seen, strict=True)])
        return
    code, g, base = way
    tabled = base >= 0.0 if m.tabled else mi.Bool(False)
    start = mi.UInt32(dr.maximum(base, 0.0))
    rate = dr.gather(mi.Float, m.log_scattered, flight.layer * m.m.padded + s.hero, asks)

    def density(w: Any) -> Any:
        """Phase function at the hero's wavelength."""
        value = m.log_phase(code, g, w)
        if m.tabled:
            row = dr.gather(mi.Float, m.rows, (start + mi.UInt32(m.cell(w))) * m.m.padded + s.hero, asks & tabled)
            value = dr.select(tabled, row - rate, value)
        return dr.exp(value)

    asked = kernel.peel.ask(s, place, flight, asks, density)
    here = asked.active
    scattered = m.packet(m.log_scattered, flight.layer, m.m.padded)
    closed = m.log_phase(code, g, asked.w)
    extra = [x + closed for x in scattered]
    if m.tabled:
        rows = m.packet(m.rows, start + mi.UInt32(m.cell(asked.w)), m.m.padded)
        extra = [dr.select(tabled, y, x) for x, y in zip(extra, rows, strict=True)]
    extra = [dr.select(here, x, 0.0) for x in extra]
    met = [dr.select(here, x, 0.0) for x in m.packet(m.log_met, flight.layer, m.m.padded)]
    lengths = [dr.select(here, x, 0.0) for x in asked.lengths]
    weight = m.weights(s.ledger, extra[: kernel.width], lengths, met)
    value = [dr.select(here, x, y) for x, y in zip(asked.strength, seen, strict=True)]
    kernel.deposit(film, s, [s.ledger.common * w * x for w, x in zip(weight, value, strict=True)])
