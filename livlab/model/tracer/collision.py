"""What happens at a collision inside: absorption or scattering, and whether a lamp is sampled from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from livlab.model.tracer.context import Context
from livlab.model.tracer.medium import HEAD
from livlab.model.tracer.next_event import NextEvent
from livlab.model.tracer.state import COLLIDE, END, NEXT_EVENT, SCATTER, WALK, PathState
from livlab.model.transport import rng as random
from livlab.model.transport.walk import events


@dataclass
class _Scatterer:
    """What a path has collided with: see a collision's row in `Medium`.

    Attributes
    ----------
    absorbed
        The free path was one that ends in absorption.
    """

    albedo: Any
    lossy: Any
    code: Any
    g: Any
    base: Any
    absorbed: Any


def collide(context: Context, next_event: NextEvent | None, s: PathState) -> PathState:
    """Absorb or scatter the lanes that have come to a collision."""
    dr, mi, m = context.dr, context.mi, context.medium
    assert m is not None
    throughput, now = s.throughput, s.collision
    arrives, scatters = s.pending == COLLIDE, s.pending == SCATTER
    hit = _scatterer(context, s, arrives)
    if next_event is not None:
        arrives = _sample_lamp(context, next_event, s, hit, arrives)
    w, scattered = _scattered(context, s, hit)
    here = arrives | scatters
    lives = _survives(context, s, hit, here)
    dead = here & ~lives
    s.d = dr.select(lives, scattered, s.d)
    throughput.counts = [
        n + dr.select(lives & (now.layer == k), mi.Float(1.0), 0.0)
        for n, k in zip(throughput.counts, m.counted, strict=True)
    ]
    if m.vector and m.tabled:
        found = m.packet(m.rows, mi.UInt32(dr.maximum(hit.base, 0.0)) + mi.UInt32(m.cell(w)), m.m.padded)
        add = lives & (hit.base >= 0.0)
        throughput.rows = [x + dr.select(add, y, 0.0) for x, y in zip(throughput.rows, found, strict=False)]
    if m.short:
        s.place.since = dr.select(here, 0.0, s.place.since)
    if next_event is not None:
        s.covered = dr.select(lives, next_event.farthest, s.covered)
        if next_event.weights.needed:
            now.pdf = dr.select(lives, next_event.weights.pdf(now, w, lives), now.pdf)
    s.pending = dr.select(lives, mi.UInt32(WALK), dr.select(dead, END, s.pending))
    return s


def _scatterer(context: Context, s: PathState, arrives: Any) -> _Scatterer:
    """Draw what the lanes have collided with."""
    dr, mi, m, now = context.dr, context.mi, context.medium, s.collision
    assert m is not None
    row = m.packet(m.collisions, now.layer * context.width + s.hero, m.collision_stride)
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
    return _Scatterer(albedo, lossy, code, g, base, absorbed=short & (base < 0.0))


def _sample_lamp(context: Context, next_event: NextEvent, s: PathState, hit: _Scatterer, arrives: Any) -> Any:
    """Choose the lanes that first sample a lamp, and keep what they hit until then; gives those that go on."""
    dr, now = context.dr, s.collision
    assert context.medium is not None
    scatters = s.pending == SCATTER
    hit.code, hit.g, hit.base = (
        dr.select(scatters, a, b) for a, b in zip((now.code, now.g, now.base), (hit.code, hit.g, hit.base), strict=True)
    )
    now.code, now.g, now.base = hit.code, hit.g, hit.base
    now.probability = next_event.probability(s, context.medium.phase_function(now, s.hero, arrives))
    samples = arrives & ~hit.absorbed & (context.uniform(s) < now.probability)
    s.pending = dr.select(samples, NEXT_EVENT, s.pending)
    return arrives & ~samples


def _scattered(context: Context, s: PathState, hit: _Scatterer) -> tuple[Any, Any]:
    """1 − cos θ of a scattering, and the direction after it."""
    dr, mi, d, m = context.dr, context.mi, context.d, context.medium
    assert m is not None
    bits, azimuth = s.stream.next_uint32(), s.stream.next_uint32()
    kind = mi.UInt32(dr.select(hit.code < 0.0, -1.0 - hit.code, 3.0))
    offset = mi.UInt32(dr.maximum(hit.code, 0.0))
    w = events.polar(d, m.m.walk, m.table, kind, hit.g, offset, random.uniform(d, bits))
    cosine, sine = events.turn(d, random.uniform(d, azimuth))
    return w, mi.Vector3f(*events.rotate(d, (s.d.x, s.d.y, s.d.z), w, cosine, sine))


def _survives(context: Context, s: PathState, hit: _Scatterer, here: Any) -> Any:
    """Lanes that are not absorbed: the first time in a layer that absorbs by weight, all others by chance."""
    dr, m, throughput, now = context.dr, context.medium, s.throughput, s.collision
    assert m is not None
    drawn = random.fine_uniform(context.d, s.stream.next_uint32())
    survival, focus = hit.albedo, None
    if m.focused:
        focus = m.pick(now.layer, m.focus)
        if context.analog:
            factor = m.factor(now.layer, context.uniform(s))
            throughput.common = dr.select(here, throughput.common * factor, throughput.common)
        else:
            survival = survival * focus
    if context.forces:
        forced = here & (throughput.forced == m.m.layers) & (hit.lossy > 0.0) & (hit.albedo > 0.0)
        throughput.forced = dr.select(forced, now.layer, throughput.forced)
        if focus is not None:
            throughput.common = dr.select(forced, throughput.common * focus, throughput.common)
        survival = dr.select(forced, 1.0, survival)
    return here & ~((drawn >= survival) | hit.absorbed)
