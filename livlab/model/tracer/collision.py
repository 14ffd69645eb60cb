"""What happens at a meeting inside: absorption or scattering, and whether a lamp is asked for its light there."""

from __future__ import annotations

from livlab.model.tracer.context import Context
from livlab.model.tracer.medium import HEAD
from livlab.model.tracer.next_event import Peel
from livlab.model.tracer.state import ASK, END, MET, TURN, WALK, State
from livlab.model.transport import rng as random
from livlab.model.transport.walk import events


def meet(context: Context, peel: Peel | None, s: State) -> State:
    """Absorb or scatter the lanes that have come to a meeting."""
    dr, mi, d, m = context.dr, context.mi, context.d, context.medium
    assert m is not None
    ledger, now = s.ledger, s.meeting
    arrives, turns = s.pending == MET, s.pending == TURN
    row = m.packet(m.meetings, now.layer * context.width + s.hero, m.meeting_stride)
    albedo, below, base, base_short, lossy = row[:HEAD]
    code, g = row[HEAD + 1], row[HEAD + 2]
    if m.ways > 1:
        v = context.uniform(s)
        for c in range(1, m.ways):
            later = v >= row[HEAD + 3 * (c - 1)]
            code = dr.select(later, row[HEAD + 3 * c + 1], code)
            g = dr.select(later, row[HEAD + 3 * c + 2], g)
    short = (now.within < below) & arrives if m.short else mi.Bool(False)
    if m.tabled:
        base = dr.select(short, base_short, base)
    gone = short & (base < 0.0)
    if peel is not None:
        code, g, base = (
            dr.select(turns, a, b) for a, b in zip((now.code, now.g, now.base), (code, g, base), strict=True)
        )
        chance = peel.chance(s, m.phase(now.layer, s.hero, code, g, base, arrives))
        asks = arrives & ~gone & (context.uniform(s) < chance)
        now.code, now.g, now.base, now.chance = code, g, base, chance
        s.pending = dr.select(asks, ASK, s.pending)
        arrives = arrives & ~asks
    bits, azimuth = s.stream.next_uint32(), s.stream.next_uint32()
    kind = mi.UInt32(dr.select(code < 0.0, -1.0 - code, 3.0))
    offset = mi.UInt32(dr.maximum(code, 0.0))
    w = events.polar(d, m.m.walk, m.table, kind, g, offset, random.uniform(d, bits))
    cosine, sine = events.turn(d, random.uniform(d, azimuth))
    turned = mi.Vector3f(*events.rotate(d, (s.d.x, s.d.y, s.d.z), w, cosine, sine))
    here = arrives | turns
    # The first meeting in a layer that absorbs is survived by weight, all others by chance.
    drawn = random.fine_uniform(d, s.stream.next_uint32())
    survival = albedo
    if m.focused:
        focus = m.pick(now.layer, m.focus)
        if context.analog:
            factor = m.factor(now.layer, context.uniform(s))
            ledger.common = dr.select(here, ledger.common * factor, ledger.common)
        else:
            survival = survival * focus
    if context.forces:
        forced = here & (ledger.forced == m.m.layers) & (lossy > 0.0) & (albedo > 0.0)
        ledger.forced = dr.select(forced, now.layer, ledger.forced)
        if m.focused:
            ledger.common = dr.select(forced, ledger.common * focus, ledger.common)
        survival = dr.select(forced, 1.0, survival)
    dead = here & ((drawn >= survival) | gone)
    lives = here & ~dead
    s.d = dr.select(lives, turned, s.d)
    ledger.counts = [
        n + dr.select(lives & (now.layer == k), mi.Float(1.0), 0.0)
        for n, k in zip(ledger.counts, m.counted, strict=True)
    ]
    if m.vector and m.tabled:
        found = m.packet(m.rows, mi.UInt32(dr.maximum(base, 0.0)) + mi.UInt32(m.cell(w)), m.m.padded)
        add = lives & (base >= 0.0)
        ledger.rows = [x + dr.select(add, y, 0.0) for x, y in zip(ledger.rows, found, strict=False)]
    if m.short:
        s.place.since = dr.select(here, 0.0, s.place.since)
    if peel is not None:
        s.covered = dr.select(lives, peel.farthest, s.covered)
        if peel.shares.needed:
            now.turned = dr.select(lives, peel.shares.density(now, w, lives), now.turned)
    s.pending = dr.select(lives, mi.UInt32(WALK), dr.select(dead, END, s.pending))
    return s
