"""Next-event estimation: light from a lamp to a collision inside, through the surface, bent there, and its layers.

A place inside sees a lamp refracted. Where the surface is taken for flat the point y at which its light enters follows
from Snell's law; deeper, a few steps find it. The light of a lamp arrives focused or spread by the surface: the ratio
of solid angles follows from the wave front's curvature before and after it (Coddington; Stavroudis 1972, chapter X):
n₂ P₂ = n₁ P₁ + (n₂ cos θ₂ − n₁ cos θ₁) S, P being the front's and S the surface's curvature on the tangent plane.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from livlab.model.tracer.context import Context
from livlab.model.tracer.mis import MisWeights
from livlab.model.tracer.state import LampSample, PathState
from livlab.model.tracer.surface import Hit

LIFT = 2e-5
"""Start of a shadow ray above the surface, as part of the body's size."""

BOOST = 2.0
"""A lamp is sampled with this probability, times what of its light would come through."""

FLOOR = 0.05
"""Least part of an even phase function that a probability counts with: its angle is a guess."""

FARTHEST = 0.1
"""Longest last leg inside on which lamps of some extent are sampled, as part of the body's size. In a ball of index
1.4 light that grazes the surface has its first focus at 0.35 of the diameter."""

STEEP = 0.02
"""Least cosine with a facet that a last leg by the surface is reckoned with."""

CAUSTIC = 0.02
"""Least part of the spread that a flat surface gives: below it light is focused more than is believed."""


@dataclass
class DirectLight:
    """Light from a lamp at a collision: in which lanes, how much at each wavelength, and what weighs it.

    Attributes
    ----------
    active
        Lanes that the lamp's light reaches.
    radiance
        What arrives, over the density of the sample, a value a wavelength.
    lengths
        Path of the light in each layer.
    log_scatter, log_collide
        Logarithms of the density to scatter towards the lamp, and of that to collide there, a value a wavelength.
    """

    active: Any
    radiance: list[Any]
    lengths: list[Any]
    log_scatter: list[Any]
    log_collide: list[Any]


@dataclass
class Connection:
    """From a place inside to a lamp, bent at the surface.

    Attributes
    ----------
    entry, normal, hit
        Where the lamp's light enters, the outward normal there, and the hit that found it.
    inside, outside
        Directions to the lamp within the body's last leg and outside.
    valid
        Lanes in which there is one.
    length, lengths
        Path inside, all of it and by layer.
    cosines
        With the surface, in each region.
    """

    entry: Any
    inside: Any
    normal: Any
    outside: Any
    valid: Any
    length: Any
    lengths: list[Any]
    cosines: list[Any]
    hit: Hit


class NextEvent:
    """Next-event estimation from inside a body: a collision samples a lamp and connects to it through the surface."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.dr, self.mi = context.dr, context.mi
        lights, m, size = context.lights, context.medium, context.size
        assert m is not None and context.flights is not None
        self.m, self.lights, self.flights = m, lights, context.flights
        one = partial(self.dr.opaque, self.mi.Float)
        self.lift = one(LIFT * size)
        # A flat patch's surface is off by as much as the field is.
        self.lift_flat = one(LIFT * size + (self.flights.field.slack if self.flights.field else 0.0))
        self.shallow = (
            self.dr.maximum(self.flights.patch, one(0.002 * size)) if self.flights.layered else one(2e-3 * size)
        )
        self.least = [one(float(x)) for x in m.m.extinction.min(axis=1)]
        mi = self.mi
        # From farther inside than this a surface may focus light: what comes from there to lamps is left to chance.
        self.farthest = one(FARTHEST * size)
        self.distant = [bool(mi.has_flag(e.flags(), mi.EmitterFlags.Infinite)) for e in lights.lamps]
        self.regions = len(m.m.regions)
        self.weights = MisWeights(context)

    def refract(self, lamp: Any, normal: Any, eta: Any) -> tuple[Any, Any, Any]:
        """Direction inside of light from the lamp's direction, and both cosines."""
        dr = self.dr
        outside = dr.dot(lamp, normal)
        along = lamp - normal * outside
        inside = dr.safe_sqrt(1.0 - eta * eta * (1.0 - outside * outside))
        return dr.normalize(along * eta + normal * inside), outside, inside

    def index_ratio(self, s: PathState, region: Any, active: Any) -> Any:
        """Index outside over that of a region."""
        dr, mi, width = self.dr, self.mi, self.context.width
        outer = dr.gather(mi.Float, self.m.index, s.hero, active)
        return outer * dr.rcp(dr.gather(mi.Float, self.m.index, (region + 1) * width + s.hero, active))

    def sample_lamp(self, s: PathState, enters: Any) -> PathState:
        """Choose the lamp and the place on it that the collisions connect to, as a path enters the body.

        Were it chosen again after each estimate, the places that are sampled less would be chosen more often.
        """
        dr, mi, lights = self.dr, self.mi, self.lights
        count = len(lights.lamps)
        chosen = dr.zeros(mi.UInt32, dr.width(s.row))
        if count > 1:
            u = self.context.uniform(s)
            chosen = dr.minimum(mi.UInt32(u * count), count - 1)
        sample = mi.Point2f(self.context.uniform(s), self.context.uniform(s))
        it = dr.zeros(mi.Interaction3f)
        it.p = s.p
        spot, distant = mi.Point3f(0.0), mi.Bool(False)
        for k, lamp in enumerate(lights.lamps):
            here = enters & (chosen == k)
            ds, _ = lamp.sample_direction(it, sample, here)
            spot = dr.select(here, mi.Point3f(ds.d) if self.distant[k] else ds.p, spot)
            distant = dr.select(here, mi.Bool(self.distant[k]), distant)
        choose = partial(dr.select, enters)
        s.lamp = LampSample(
            number=choose(chosen, s.lamp.number),
            sample=choose(sample, s.lamp.sample),
            spot=choose(spot, s.lamp.spot),
            distant=choose(distant, s.lamp.distant),
        )
        return s

    def toward(self, lamp: LampSample, p: Any) -> Any:
        """Direction from a place to the sample of the lamp."""
        return self.dr.select(lamp.distant, self.mi.Vector3f(lamp.spot), self.dr.normalize(lamp.spot - p))

    def probability(self, s: PathState, phase: Callable[[Any], Any]) -> Any:
        """Probability that a collision samples its lamp: what a flat surface would let through of its light."""
        dr, mi = self.dr, self.mi
        eta = self.index_ratio(s, s.medium - 1, True)
        inside, _, cosine = self.refract(self.toward(s.lamp, s.p), -s.place.inward, eta)
        w = 0.5 * dr.squared_norm(s.d - inside)
        # Never more than the surface's own nearness allows, nor by far: what is sampled too seldom weighs too much.
        depth, place = mi.Float(0.0), s.place
        if self.flights.layered:
            depth = dr.maximum(dr.select(place.depth < self.shallow, place.depth, place.clear), 0.0)
        tau = self.m.pick(s.collision.layer, self.least) * depth * dr.rcp(dr.maximum(cosine, 0.7))
        return dr.minimum(BOOST * dr.maximum(12.566 * phase(w), FLOOR) * dr.exp(-tau), 1.0)

    def intensity(self, s: PathState, p: Any, active: Any) -> list[Any]:
        """Irradiance of the lamp in a place near p if it is distant, else its intensity, a value a wavelength."""
        dr, mi, lights = self.dr, self.mi, self.lights
        count = float(len(lights.lamps))
        it = dr.zeros(mi.Interaction3f)
        it.p = p
        intensity = [mi.Float(0.0) for _ in range(self.context.width)]
        for k, lamp in enumerate(lights.lamps):
            here = active & (s.lamp.number == k)
            found, ds = lights.arriving(lamp, it, s.lamp.sample, here)
            scale = mi.Float(count) if self.distant[k] else count * dr.square(ds.dist)
            intensity = [dr.select(here, x * scale, z) for x, z in zip(found, intensity, strict=True)]
        return intensity

    def estimate(self, s: PathState, samples: Any) -> DirectLight:
        """Sample a lamp's light at a collision."""
        dr, mi, m, now, lights = self.dr, self.mi, self.m, s.collision, self.lights
        region = s.medium - 1
        normal, depth, near = self.nearest_surface(s, samples)
        eta = self.index_ratio(s, region, samples)
        link = self.connect(s, normal, depth, near, eta, samples)
        c2 = dr.dot(link.outside, link.normal)
        # Lamps without extent are never hit by chance.
        extended = self.m.pick(s.lamp.number, [mi.Bool(x in lights.surfaces) for x in lights.lamps])
        valid = samples & link.valid & (c2 > 0.0) & ((link.length < self.farthest) | ~extended)
        c2 = dr.maximum(c2, 1e-4)
        distant = s.lamp.distant
        far = dr.select(distant, 0.0, dr.norm(s.lamp.spot - link.entry))
        factor = self.spread(link, c2, distant, far, dr.rcp(eta), near, valid)
        lift = dr.select(link.hit.body & ~link.hit.outward, self.lift, self.lift_flat)
        ray = mi.Ray3f(link.entry + link.normal * lift, link.outside)
        ray.maxt = dr.select(distant, 1e30, (far - lift) * (1.0 - 1e-4))
        valid &= ~self.context.scene.ray_test(ray, valid)
        for r in range(self.regions):
            if m.m.refracts[r]:
                passes = valid & (region >= r)
                row = m.fresnel_row(mi.UInt32(r), mi.Bool(True), dr.minimum(link.cosines[r], 1.0))
                reflected = dr.gather(mi.Float, m.reflectance, row * m.m.padded + s.hero, passes)
                factor = dr.select(passes, factor * (1.0 - reflected), factor)
        factor = dr.select(valid, factor * dr.rcp(dr.maximum(now.probability, 1e-6)), 0.0)
        if m.focused:
            factor = factor * m.pick(now.layer, m.focus)
        w = 0.5 * dr.squared_norm(s.d - link.inside)
        if self.weights.needed:
            factor = factor * self.weights.of_sampled(s, w, valid)
        radiance = [x * factor for x in self.intensity(s, link.entry, valid)]
        scattered = m.packet(m.log_scattered, now.layer, m.m.padded)
        closed = m.log_phase(now.code, now.g, w)
        log_scatter = [x + closed for x in scattered]
        if m.tabled:
            at = mi.UInt32(dr.maximum(now.base, 0.0)) + mi.UInt32(m.cell(w))
            rows = m.packet(m.rows, at, m.m.padded)
            log_scatter = [dr.select(now.base >= 0.0, y, x) for x, y in zip(log_scatter, rows, strict=True)]
        log_collide = m.packet(m.log_extinction, now.layer, m.m.padded)
        return DirectLight(
            active=valid,
            radiance=radiance,
            lengths=[dr.select(valid, x, 0.0) for x in link.lengths],
            log_scatter=[dr.select(valid, x, 0.0) for x in log_scatter[: self.context.width]],
            log_collide=[dr.select(valid, x, 0.0) for x in log_collide],
        )

    def nearest_surface(self, s: PathState, samples: Any) -> tuple[Any, Any, Any]:
        """Outward normal at the nearest point of the surface, depth below it, and whether it counts as flat there."""
        dr, mi, place = self.dr, self.mi, s.place
        field = self.flights.field
        if field is None:
            return -place.inward, mi.Float(0.0), mi.Bool(False)
        if not self.flights.layered:
            depth, inward = field.look(s.p, samples)
            return -inward, dr.maximum(depth, 0.0), depth < self.shallow
        near = place.depth < self.shallow
        depth, inward = field.look(s.p, samples & ~near)
        normal = -dr.select(near, place.inward, inward)
        return normal, dr.maximum(dr.select(near, place.depth, depth), 0.0), near

    def connect(self, s: PathState, normal: Any, depth: Any, near: Any, eta: Any, goes: Any) -> Connection:
        """Find where a lamp's light enters to come to a place inside."""
        dr, mi, sample = self.dr, self.mi, s.lamp
        if self.context.interfaces > 1:
            return self.connect_nested(s, normal, goes)
        field = self.flights.field
        deep, y = goes & ~near, s.p
        lamp = self.toward(sample, s.p + normal * depth)
        inside, out, cosine = self.refract(lamp, normal, eta)
        blind = deep
        if field is not None:
            y = s.p + inside * (depth * dr.rcp(dr.maximum(cosine, 1e-3)))
            _, inward = field.look(y, deep)
            normal = dr.select(near, normal, -inward)
            blind = deep & (out <= 0.0)
        # Where the nearest surface looks away from the lamp, the straight line to it is what is known.
        hit = self.context.surface.intersect(mi.Ray3f(s.p, dr.select(out > 0.0, inside, lamp)), blind)
        y, normal = dr.select(hit.body, hit.p, y), dr.select(hit.body, hit.normal, normal)
        lamp = self.toward(sample, y)
        inside, out, cosine = self.refract(lamp, normal, eta)
        hit = self.context.surface.intersect(mi.Ray3f(s.p, inside), goes)
        found = hit.body & ~hit.outward
        # Rounding may have left a place by the surface outside: there the depth is what is known.
        onto = deep | found
        y = dr.select(onto, hit.p, s.p + inside * (depth * dr.rcp(dr.maximum(cosine, 1e-3))))
        normal = dr.select(onto, hit.normal, normal)
        lamp = self.toward(sample, y)
        inside, out, cosine = self.refract(lamp, normal, eta)
        flat = depth * dr.rcp(dr.maximum(cosine, 1e-3))
        # By the surface itself: the depth is off by some µm, δ, and where free paths are no longer its e^(µt δ) counts.
        steep = dr.maximum(dr.dot(inside, hit.facet), STEEP)
        leg = dr.select(near, dr.maximum(dr.dot(hit.p - s.p, hit.facet), 0.0) * dr.rcp(steep), hit.t)
        path = dr.select(onto, leg, flat)
        good = ~deep | found
        sine = 1.0 - dr.square(dr.dot(lamp, normal))
        cosines = []
        for r in range(self.regions):
            ratio = self.index_ratio(s, mi.UInt32(r), goes)
            cosines.append(dr.safe_sqrt(1.0 - ratio * ratio * sine))
        lengths = [path]
        if self.flights.layered:
            lengths = self._by_layer(s, depth, path, flat, deep, near, cosines)
        return Connection(
            entry=y,
            inside=inside,
            normal=normal,
            outside=lamp,
            valid=good & (out > 0.0),
            length=path,
            lengths=lengths,
            cosines=cosines,
            hit=hit,
        )

    def _by_layer(
        self, s: PathState, depth: Any, path: Any, flat: Any, deep: Any, near: Any, cosines: list[Any]
    ) -> list[Any]:
        """A connection's path in each layer told by depth, `flat` being its length if the surface were."""
        dr, mi, m = self.dr, self.mi, self.m
        owner = [next(r for r, (a, b) in enumerate(m.m.regions) if a <= k <= b) for k in range(m.m.layers)]
        lengths, rest = [], path
        for k in range(m.m.layers):
            top = m.top[k] if k else mi.Float(0.0)
            high = dr.maximum(dr.minimum(depth, m.top[k + 1]) - top, 0.0)
            lengths.append(high * dr.rcp(dr.maximum(cosines[owner[k]], 1e-3)))
            rest = rest - lengths[k]
        # What the depth is off by belongs to the collision's layer deep inside, to the uppermost by the surface.
        rest = dr.select(near, path - flat, rest)
        own = [(deep & (s.collision.layer == k)) | (near & mi.Bool(k == 0)) for k in range(m.m.layers)]
        return [dr.maximum(x + dr.select(o, rest, 0.0), 0.0) for x, o in zip(lengths, own, strict=True)]

    def connect_nested(self, s: PathState, normal: Any, goes: Any) -> Connection:
        """The same through nested surfaces, each hit in its turn."""
        dr, mi = self.dr, self.mi
        lamp = self.toward(s.lamp, s.p)
        for last_try in (False, True):
            lengths: list[Any] = []
            cosines: list[Any] = []
            y, path = s.p, mi.Float(0.0)
            good = goes & True  # a mask of its own: `&=` changes in place
            first, found = mi.Vector3f(0.0), normal
            for r in reversed(range(self.regions)):
                ratio = self.index_ratio(s, mi.UInt32(r), goes)
                inside, out, cosine = self.refract(lamp, normal, ratio)
                if not last_try:
                    # Where the surface last crossed looks away from the lamp, the line to it is what is known.
                    inside = dr.select(out > 0.0, inside, lamp)
                here = good & (s.medium - 1 >= r)
                if last_try:
                    here &= out > 0.0
                # Past the interface that the last leg ended at: rounding may have left it ahead.
                past = dr.select(s.medium - 1 > r, self.lift, 0.0)
                hit = self.context.surface.intersect(mi.Ray3f(dr.fma(past, inside, y), inside), here)
                good &= ~here | (hit.body & ~hit.outward & (hit.interface == r))
                if last_try:
                    good &= out > 0.0
                first = dr.select(s.medium - 1 == r, inside, first)
                y = dr.select(here, hit.p, y)
                lengths.insert(0, dr.select(here, hit.t + past, 0.0))
                cosines.insert(0, cosine)
                path = path + lengths[0]
                last, found = hit, dr.select(here, hit.normal, found)
            normal = dr.select(good, found, normal)
            lamp = self.toward(s.lamp, y)
        return Connection(
            entry=y,
            inside=first,
            normal=normal,
            outside=lamp,
            valid=good,
            length=path,
            lengths=lengths,
            cosines=cosines,
            hit=last,
        )

    def spread(self, link: Connection, c2: Any, distant: Any, far: Any, eta: Any, near: Any, active: Any) -> Any:
        """Solid angle inside for one of the lamp's: of direction if it is distant, of area at it if not."""
        dr, mi = self.dr, self.mi
        n, lamp = link.normal, link.outside
        du, dv, turn_u, turn_v = self.context.surface.curvature(link.hit, active & ~near)
        c1 = dr.safe_sqrt(1.0 - (1.0 - c2 * c2) * dr.square(dr.rcp(eta)))
        along = lamp - n * c2
        length = dr.squared_norm(along)
        other, _ = mi.coordinate_system(n)
        t = dr.select(length > 1e-8, along * dr.rsqrt(dr.maximum(length, 1e-12)), other)
        b = dr.cross(n, t)
        uu, uv, vv = dr.squared_norm(du), dr.dot(du, dv), dr.squared_norm(dv)
        determinant = uu * vv - uv * uv
        flat = near | (determinant <= 0.0)
        inverse = dr.rcp(dr.select(flat, 1.0, determinant))

        def turned(v: Any) -> Any:
            p, q = dr.dot(v, du), dr.dot(v, dv)
            return (turn_u * (vv * p - uv * q) + turn_v * (uu * q - uv * p)) * inverse

        dt, db = turned(t), turned(b)
        gain = dr.select(flat, 0.0, link.length * (c2 - eta * c1))
        tt = dr.fma(gain, dr.dot(t, dt), eta * c1 * c1)
        bb = dr.fma(gain, dr.dot(b, db), eta)
        tb = gain * 0.5 * (dr.dot(t, db) + dr.dot(b, dt))
        least = CAUSTIC * dr.square(eta * c1)
        by_angle = c1 * c2 * dr.rcp(dr.maximum(dr.abs(tt * bb - tb * tb), least))
        ntt, nbb = link.length + far * tt * dr.rcp(c2 * c2), link.length + far * bb
        ntb = far * tb * dr.rcp(c2)
        least = CAUSTIC * dr.square(link.length + far * eta)
        by_area = c1 * dr.rcp(c2 * dr.maximum(dr.abs(ntt * nbb - ntb * ntb), dr.maximum(least, 1e-20)))
        return dr.select(distant, by_angle, by_area)
