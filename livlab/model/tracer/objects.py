"""Other objects in the scene, by Mitsuba's reflection models: light goes on from them, and lamps light them.

Mitsuba's spectral variants know four wavelengths at a time, so a model is asked once for every four, with the same
random numbers; models choose directions alike at all wavelengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from livlab.model.tracer.context import Context
from livlab.model.tracer.lights import GROUP, groups
from livlab.model.tracer.state import OUT, State
from livlab.model.tracer.surface import Hit

KEPT = 0.95
"""Greatest chance with which a path goes on after an object."""

EARLY = 4
"""Objects met before chance decides."""


@dataclass
class Bounce:
    """What a light met next needs to know of the last object.

    Attributes
    ----------
    p, density
        Where the ray was sent off, and with what density of direction; 0 where lights count fully.
    count
        Objects met.
    """

    p: Any
    density: Any
    count: Any


class Objects:
    """The surfaces of a scene that are no body's."""

    def __init__(self, context: Context) -> None:
        self.context, self.mi, self.dr = context, context.mi, context.dr
        self.grid = groups(context.lights.grid)

    def start(self, n: int) -> Bounce:
        """No object met yet."""
        dr, mi = self.dr, self.mi
        return Bounce(dr.zeros(mi.Point3f, n), dr.zeros(mi.Float, n), dr.zeros(mi.UInt32, n))

    def share(self, s: State, hit: Hit, met: Any) -> Any:
        """Share of a light met that the last object did not ask for itself (balance heuristic, Veach 1997)."""
        dr, mi, scene = self.dr, self.mi, self.context.scene
        bounce = s.bounce
        asked = met & (bounce.density > 0.0)
        si = hit.found.compute_surface_interaction(hit.ray, mi.RayFlags.All, asked)
        before = dr.zeros(mi.Interaction3f)
        before.p = bounce.p
        ds = mi.DirectionSample3f(scene, si, before)
        other = scene.pdf_emitter_direction(before, ds, asked)
        return dr.select(asked, bounce.density * dr.rcp(dr.maximum(bounce.density + other, 1e-30)), 1.0)

    def meet(self, s: State, hit: Hit, met: Any) -> tuple[list[Any], State]:
        """Light that lamps send to an object and it to the path; and the path sent on from it."""
        dr, mi, scene = self.dr, self.mi, self.context.scene
        context = mi.BSDFContext()
        si = hit.found.compute_surface_interaction(hit.ray, mi.RayFlags.All, met)
        bsdf = si.bsdf(hit.ray)
        draw = partial(self.context.uniform, s)
        lamp, lobe, place = mi.Point2f(draw(), draw()), draw(), mi.Point2f(draw(), draw())
        smooth = met & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        light: list[Any] = []
        onward: list[Any] = []
        visible: Any = None
        sent: Any = None
        for group in self.grid:
            si.wavelengths = mi.UnpolarizedSpectrum(*group)
            ds, arriving = scene.sample_emitter_direction(si, lamp, False, smooth)
            if visible is None:
                lit = smooth & (ds.pdf != 0.0)
                visible = lit & ~scene.ray_test(si.spawn_ray_to(ds.p), lit)
            wo = si.to_local(ds.d)
            value, density = bsdf.eval_pdf(context, si, wo, visible)
            share = dr.select(ds.delta, 1.0, ds.pdf * dr.rcp(dr.maximum(ds.pdf + density, 1e-30)))
            sample, weight = bsdf.sample(context, si, lobe, place, met)
            light += [dr.select(visible, value[k] * arriving[k] * share, 0.0) for k in range(GROUP)]
            onward += [weight[k] for k in range(GROUP)]
            sent = sample if sent is None else sent
        width = self.context.width
        ledger, bounce = s.ledger, s.bounce
        direction = si.to_world(sent.wo)
        ray = si.spawn_ray(direction)
        delta = mi.has_flag(sent.sampled_type, mi.BSDFFlags.Delta)
        factor = [dr.select(met, x, 1.0) for x in onward[:width]]
        carried = [x * y for x, y in zip(ledger.carried, factor, strict=True)]
        # Chance depends on the path alone, not on the wavelength that leads it: it is the same in every density.
        most: Any = carried[0]
        for x in carried[1:]:
            most = dr.maximum(most, x)
        kept = dr.select(bounce.count >= EARLY, dr.clip(most, 0.05, KEPT), 1.0)
        ends = met & ((draw() >= kept) | (most <= 0.0))
        value = [x * y for x, y in zip(light[:width], ledger.carried, strict=True)]
        scale = dr.select(met, dr.rcp(kept), 1.0)
        ledger.carried = [x * scale for x in carried]
        goes = met & ~ends
        s.p, s.d = dr.select(goes, ray.o, s.p), dr.select(goes, direction, s.d)
        bounce.p = dr.select(goes, si.p, bounce.p)
        bounce.density = dr.select(goes, dr.select(delta, 0.0, sent.pdf), bounce.density)
        bounce.count = bounce.count + dr.select(goes, mi.UInt32(1), 0)
        s.fresh, s.covered = s.fresh & ~met, dr.select(met, 0.0, s.covered)
        s.pending = dr.select(goes, mi.UInt32(OUT), s.pending)
        return value, s
