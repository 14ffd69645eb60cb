"""Other objects in the scene, by Mitsuba's reflection models: light goes on from them, and lamps light them.

Mitsuba's spectral variants know four wavelengths at a time, so a model is asked once for every four, with the same
random numbers; models choose directions alike at all wavelengths.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from livlab.model.tracer.context import Context
from livlab.model.tracer.lights import GROUP, groups
from livlab.model.tracer.state import OUTSIDE, Bounce, PathState
from livlab.model.tracer.surface import Hit

LEVEL = 0.25
"""Share of its first weight below which chance decides whether a path goes on after an object; it then weighs this.

A path that weighs more always goes on: one ended by chance at full weight makes those that are left weigh more with
every object, and their variance grows without end (by 1/0.95 an object in a white room, if one in twenty is ended)."""

EARLY = 4
"""Objects hit before chance decides."""


class Objects:
    """The surfaces of a scene that are no body's."""

    def __init__(self, context: Context) -> None:
        self.context, self.mi, self.dr = context, context.mi, context.dr
        self.grid = groups(context.lights.grid)

    def start(self, n: int) -> Bounce:
        """No object hit yet."""
        dr, mi = self.dr, self.mi
        return Bounce(dr.zeros(mi.Point3f, n), dr.zeros(mi.Float, n), dr.zeros(mi.UInt32, n))

    def mis_weight(self, s: PathState, hit: Hit, lit: Any) -> Any:
        """Weight of a light hit that the last object may have sampled too (balance heuristic, Veach 1997, eq. 9.8)."""
        dr, mi, scene = self.dr, self.mi, self.context.scene
        bounce = s.bounce
        sampled = lit & (bounce.pdf > 0.0)
        si = hit.found.compute_surface_interaction(hit.ray, mi.RayFlags.All, sampled)
        before = dr.zeros(mi.Interaction3f)
        before.p = bounce.p
        ds = mi.DirectionSample3f(scene, si, before)
        other = scene.pdf_emitter_direction(before, ds, sampled)
        return dr.select(sampled, bounce.pdf * dr.rcp(dr.maximum(bounce.pdf + other, 1e-30)), 1.0)

    def reflect(self, s: PathState, hit: Hit, hits: Any) -> tuple[list[Any], PathState]:
        """Light that lamps send to an object and it to the path; and the path sent on from it."""
        dr, mi, scene = self.dr, self.mi, self.context.scene
        context = mi.BSDFContext()
        si = hit.found.compute_surface_interaction(hit.ray, mi.RayFlags.All, hits)
        bsdf = si.bsdf(hit.ray)
        draw = partial(self.context.uniform, s)
        lamp, lobe, place = mi.Point2f(draw(), draw()), draw(), mi.Point2f(draw(), draw())
        smooth = hits & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
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
            value, pdf = bsdf.eval_pdf(context, si, wo, visible)
            mis = dr.select(ds.delta, 1.0, ds.pdf * dr.rcp(dr.maximum(ds.pdf + pdf, 1e-30)))
            sample, weight = bsdf.sample(context, si, lobe, place, hits)
            light += [dr.select(visible, value[k] * arriving[k] * mis, 0.0) for k in range(GROUP)]
            onward += [weight[k] for k in range(GROUP)]
            sent = sample if sent is None else sent
        width = self.context.width
        throughput, bounce = s.throughput, s.bounce
        direction = si.to_world(sent.wo)
        ray = si.spawn_ray(direction)
        delta = mi.has_flag(sent.sampled_type, mi.BSDFFlags.Delta)
        factor = [dr.select(hits, x, 1.0) for x in onward[:width]]
        carried = [x * y for x, y in zip(throughput.carried, factor, strict=True)]
        # Chance depends on the path alone, not on the wavelength that leads it: it is the same in every density.
        most: Any = carried[0]
        for x in carried[1:]:
            most = dr.maximum(most, x)
        kept = dr.select(bounce.count >= EARLY, dr.clip(most * (1.0 / LEVEL), 1e-30, 1.0), 1.0)
        ends = hits & ((draw() >= kept) | (most <= 0.0))
        value = [x * y for x, y in zip(light[:width], throughput.carried, strict=True)]
        scale = dr.select(hits, dr.rcp(kept), 1.0)
        throughput.carried = [x * scale for x in carried]
        goes = hits & ~ends
        s.p, s.d = dr.select(goes, ray.o, s.p), dr.select(goes, direction, s.d)
        bounce.p = dr.select(goes, si.p, bounce.p)
        bounce.pdf = dr.select(goes, dr.select(delta, 0.0, sent.pdf), bounce.pdf)
        bounce.count = bounce.count + dr.select(goes, mi.UInt32(1), 0)
        s.fresh, s.covered = s.fresh & ~hits, dr.select(hits, 0.0, s.covered)
        s.pending = dr.select(goes, mi.UInt32(OUTSIDE), s.pending)
        return value, s
