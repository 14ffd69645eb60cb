"""Light from a lamp to a place inside a body: through the surface, bent there, and through its layers.

A place inside sees a lamp refracted. Where the surface is taken for flat the point y at which its light enters follows
from Snell's law; deeper, a few steps find it. The light of a lamp arrives focused or spread by the surface: the ratio
of solid angles follows from the wave front's curvature before and after it (Coddington; Stavroudis 1972, chapter X):
n₂ P₂ = n₁ P₁ + (n₂ cos θ₂ − n₁ cos θ₁) S, P being the front's and S the surface's curvature on the tangent plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from livlab.model.tracer.flight import Flight
from livlab.model.tracer.state import Place, State
from livlab.model.transport import rng as random

if TYPE_CHECKING:
    from livlab.model.tracer.kernel import Kernel

LIFT = 2e-5
"""Start of a shadow ray above the surface, as part of the body's size."""

BOOST = 2.0
"""A lamp is asked for with this chance, times what of its light would come through."""

CAUSTIC = 0.02
"""Least part of the spread that a flat surface gives: below it light is focused more than is believed."""


@dataclass
class Asked:
    """Light from a lamp: in which lanes, how much at each wavelength, and what the weights need to know of its way."""

    active: Any
    strength: list[Any]
    lengths: list[Any]
    w: Any


@dataclass
class Way:
    """From a place inside to a lamp: where it enters, the direction inside, cosines and distances."""

    y: Any
    inside: Any
    normal: Any
    lamp: Any
    good: Any
    path: Any
    legs: list[Any]
    cosines: list[Any]
    si: Any


class Peel:
    """Asks for lamps from inside a body."""

    def __init__(self, kernel: Kernel, size: float) -> None:
        self.k = kernel
        self.dr, self.mi = kernel.dr, kernel.mi
        lights, m = kernel.lights, kernel.medium
        assert m is not None and kernel.flights is not None
        self.m, self.lights, self.flights = m, lights, kernel.flights
        one = partial(self.dr.opaque, self.mi.Float)
        self.lift = one(LIFT * size)
        # A flat patch's surface is off by as much as the field is.
        self.lift_flat = one(LIFT * size + (self.flights.field.slack if self.flights.field else 0.0))
        self.shallow = (
            self.dr.maximum(self.flights.patch, one(0.002 * size)) if self.flights.layered else one(2e-3 * size)
        )
        self.least = [one(float(x)) for x in m.m.extinction.min(axis=1)]
        mi = self.mi
        self.distant = [bool(mi.has_flag(e.flags(), mi.EmitterFlags.Infinite)) for e in lights.lamps]
        self.regions = len(m.m.regions)

    def bend(self, lamp: Any, normal: Any, eta: Any) -> tuple[Any, Any, Any]:
        """Direction inside of light from the lamp's direction, and both cosines."""
        dr = self.dr
        outside = dr.dot(lamp, normal)
        along = lamp - normal * outside
        inside = dr.safe_sqrt(1.0 - eta * eta * (1.0 - outside * outside))
        return dr.normalize(along * eta + normal * inside), outside, inside

    def ratio(self, s: State, region: Any, active: Any) -> Any:
        """Index outside over that of a region."""
        dr, mi, width = self.dr, self.mi, self.k.width
        outer = dr.gather(mi.Float, self.m.index, s.hero, active)
        return outer * dr.rcp(dr.gather(mi.Float, self.m.index, (region + 1) * width + s.hero, active))

    def sample(self, s: State, y: Any, active: Any) -> tuple[Any, Any, Any, list[Any]]:
        """A lamp: direction to it from near y, its place, whether it is distant, and its irradiance or intensity."""
        dr, mi, lights = self.dr, self.mi, self.lights
        count = len(lights.lamps)
        u = random.uniform(self.k.d, s.stream.next_uint32())
        sample = mi.Point2f(
            random.uniform(self.k.d, s.stream.next_uint32()), random.uniform(self.k.d, s.stream.next_uint32())
        )
        it = dr.zeros(mi.Interaction3f)
        it.p = y
        direction, place = mi.Vector3f(0.0, 0.0, 1.0), mi.Point3f(0.0)
        distant = mi.Bool(False)
        strength = [mi.Float(0.0) for _ in range(self.k.width)]
        chosen = dr.minimum(mi.UInt32(u * count), count - 1)
        for k, lamp in enumerate(lights.lamps):
            here = active & (chosen == k)
            found, ds = lights.arriving(lamp, it, sample, here)
            scale = mi.Float(float(count)) if self.distant[k] else count * dr.square(ds.dist)
            strength = [dr.select(here, x * scale, y_) for x, y_ in zip(found, strength, strict=True)]
            direction, place = dr.select(here, ds.d, direction), dr.select(here, ds.p, place)
            distant = dr.select(here, self.distant[k], distant)
        return direction, place, distant, strength

    def ask(self, s: State, place: Place, flight: Flight, asks: Any, density: Any) -> Asked:
        """Ask a lamp for its light at a meeting."""
        dr, mi, m = self.dr, self.mi, self.m
        region = s.medium - 1
        normal, depth, near = self.above(s, place, asks)
        y0 = s.p + normal * depth
        direction, spot, distant, strength = self.sample(s, y0, asks)
        eta = self.ratio(s, region, asks)

        def toward(y: Any) -> Any:
            return dr.select(distant, direction, dr.normalize(spot - y))

        inside, out, cosine = self.bend(toward(y0), normal, eta)
        # Chance to go on: what a flat surface at this depth would let through, and the phase function send there.
        reach = depth * dr.rcp(dr.maximum(cosine, 1e-3))
        tau = m.pick(flight.layer, self.least) * reach
        w = 0.5 * dr.squared_norm(s.d - inside)
        chance = dr.minimum(BOOST * 12.566 * density(w) * dr.exp(-tau), 1.0)
        goes = asks & (out > 0.0) if self.flights.field is not None and self.flights.layered else asks
        goes &= random.uniform(self.k.d, s.stream.next_uint32()) < chance
        way = self.way(s, place, flight, normal, depth, near, eta, toward, goes)
        good = goes & way.good
        lamp = way.lamp
        c2 = dr.dot(lamp, way.normal)
        good &= c2 > 0.0
        c2 = dr.maximum(c2, 1e-4)
        far = dr.select(distant, 0.0, dr.norm(spot - way.y))
        factor = self.spread(way, lamp, c2, distant, far, 1.0 * dr.rcp(eta), near)
        lift = dr.select(near, self.lift_flat, self.lift)
        ray = mi.Ray3f(way.y + way.normal * lift, lamp)
        ray.maxt = dr.select(distant, 1e30, (far - lift) * (1.0 - 1e-4))
        good &= ~self.k.scene.ray_test(ray, good)
        for r in range(self.regions):
            if m.m.refracts[r]:
                passes = good & (region >= r)
                row = m.fresnel_row(mi.UInt32(r), mi.Bool(True), dr.minimum(way.cosines[r], 1.0))
                reflected = dr.gather(mi.Float, m.reflectance, row * m.m.padded + s.hero, passes)
                factor = dr.select(passes, factor * (1.0 - reflected), factor)
        factor = dr.select(good, factor * dr.rcp(dr.maximum(chance, 1e-6)), 0.0)
        return Asked(good, [x * factor for x in strength], way.legs, 0.5 * dr.squared_norm(s.d - way.inside))

    def above(self, s: State, place: Place, asks: Any) -> tuple[Any, Any, Any]:
        """Outward normal at the nearest point of the surface, depth below it, and whether it counts as flat there."""
        dr, mi = self.dr, self.mi
        field = self.flights.field
        if field is None:
            return -place.inward, mi.Float(0.0), mi.Bool(False)
        if not self.flights.layered:
            depth, inward = field.look(s.p, asks)
            return -inward, dr.maximum(depth, 0.0), depth < self.shallow
        near = place.depth < self.shallow
        depth, inward = field.look(s.p, asks & ~near)
        return (
            -dr.select(near, place.inward, inward),
            dr.maximum(dr.select(near, place.depth, depth), 0.0),
            near,
        )

    def way(
        self,
        s: State,
        place: Place,
        flight: Flight,
        normal: Any,
        depth: Any,
        near: Any,
        eta: Any,
        toward: Any,
        goes: Any,
    ) -> Way:
        """Find where a lamp's light enters to come to a place inside."""
        dr, mi, m = self.dr, self.mi, self.m
        if self.k.medium is not None and len(self.k.shapes) > 1:
            return self.through(s, normal, toward, goes)
        field = self.flights.field
        lamp = toward(s.p + normal * depth)
        inside, out, cosine = self.bend(lamp, normal, eta)
        good = out > 0.0
        deep = goes & ~near
        if field is not None:
            y = s.p + inside * (depth * dr.rcp(dr.maximum(cosine, 1e-3)))
            _, inward = field.look(y, deep)
            bent = dr.select(near, normal, -inward)
            lamp = toward(y)
            inside, out, cosine = self.bend(lamp, bent, eta)
            y = s.p + inside * (depth * dr.rcp(dr.maximum(cosine, 1e-3)))
            normal = bent
            good = out > 0.0
        else:
            hit = self.k.hit_surface(s.p, inside, deep)
            y, bent = hit.si.p, hit.normal
            lamp = toward(y)
            inside, out, cosine = self.bend(lamp, dr.select(hit.body, bent, normal), eta)
        hit = self.k.hit_surface(s.p, inside, deep)
        good &= ~deep | (hit.body & ~hit.outward)
        y = dr.select(deep, hit.si.p, y)
        normal = dr.select(deep, hit.normal, normal)
        lamp = toward(y)
        inside, out, cosine = self.bend(lamp, normal, eta)
        path = dr.select(deep, hit.t, depth * dr.rcp(dr.maximum(cosine, 1e-3)))
        sine = 1.0 - dr.square(dr.dot(lamp, normal))
        cosines = []
        for r in range(self.regions):
            ratio = self.ratio(s, mi.UInt32(r), goes)
            cosines.append(dr.safe_sqrt(1.0 - ratio * ratio * sine))
        legs = []
        if self.flights.layered:
            owner = [next(r for r, (a, b) in enumerate(m.m.regions) if a <= k <= b) for k in range(m.m.layers)]
            rest = path
            for k in range(m.m.layers):
                top = m.top[k] if k else mi.Float(0.0)
                high = dr.maximum(dr.minimum(depth, m.top[k + 1]) - top, 0.0)
                legs.append(high * dr.rcp(dr.maximum(cosines[owner[k]], 1e-3)))
                rest = rest - legs[k]
            own = [flight.layer == k for k in range(m.m.layers)]
            legs = [dr.maximum(x + dr.select(deep & o, rest, 0.0), 0.0) for x, o in zip(legs, own, strict=True)]
        else:
            legs = [path]
        return Way(y, inside, normal, lamp, good & (out > 0.0), path, legs, cosines, hit.si)

    def through(self, s: State, normal: Any, toward: Any, goes: Any) -> Way:
        """The same through nested surfaces, each met in its turn."""
        dr, mi = self.dr, self.mi
        lamp = toward(s.p)
        for _ in range(2):
            legs: list[Any] = []
            cosines: list[Any] = []
            y, good, path = s.p, goes, mi.Float(0.0)
            first, si, found = mi.Vector3f(0.0), None, normal
            for r in reversed(range(self.regions)):
                ratio = self.ratio(s, mi.UInt32(r), goes)
                inside, out, cosine = self.bend(lamp, normal, ratio)
                here = good & (s.medium - 1 >= r) & (out > 0.0)
                hit = self.k.hit_surface(y, inside, here)
                good &= ~here | (hit.body & ~hit.outward & (hit.interface == r))
                good &= out > 0.0
                first = dr.select(s.medium - 1 == r, inside, first)
                y = dr.select(here, hit.si.p, y)
                legs.insert(0, dr.select(here, hit.t, 0.0))
                cosines.insert(0, cosine)
                path = path + legs[0]
                si, found = hit.si, dr.select(here, hit.normal, found)
            normal = dr.select(good, found, normal)
            lamp = toward(y)
        return Way(y, first, normal, lamp, good, path, legs, cosines, si)

    def spread(self, way: Way, lamp: Any, c2: Any, distant: Any, far: Any, eta: Any, near: Any) -> Any:
        """Solid angle inside for one of the lamp's: of direction if it is distant, of area at it if not."""
        dr, mi = self.dr, self.mi
        n, si = way.normal, way.si
        c1 = dr.safe_sqrt(1.0 - (1.0 - c2 * c2) * dr.square(dr.rcp(eta)))
        along = lamp - n * c2
        length = dr.squared_norm(along)
        other, _ = mi.coordinate_system(n)
        t = dr.select(length > 1e-8, along * dr.rsqrt(dr.maximum(length, 1e-12)), other)
        b = dr.cross(n, t)
        uu, uv, vv = dr.squared_norm(si.dp_du), dr.dot(si.dp_du, si.dp_dv), dr.squared_norm(si.dp_dv)
        determinant = uu * vv - uv * uv
        flat = near | (determinant <= 0.0)
        inverse = dr.rcp(dr.select(flat, 1.0, determinant))

        def turned(v: Any) -> Any:
            p, q = dr.dot(v, si.dp_du), dr.dot(v, si.dp_dv)
            return (si.dn_du * (vv * p - uv * q) + si.dn_dv * (uu * q - uv * p)) * inverse

        dt, db = turned(t), turned(b)
        gain = dr.select(flat, 0.0, way.path * (c2 - eta * c1))
        tt = dr.fma(gain, dr.dot(t, dt), eta * c1 * c1)
        bb = dr.fma(gain, dr.dot(b, db), eta)
        tb = gain * 0.5 * (dr.dot(t, db) + dr.dot(b, dt))
        least = CAUSTIC * dr.square(eta * c1)
        by_angle = c1 * c2 * dr.rcp(dr.maximum(dr.abs(tt * bb - tb * tb), least))
        ntt, nbb = way.path + far * tt * dr.rcp(c2 * c2), way.path + far * bb
        ntb = far * tb * dr.rcp(c2)
        least = CAUSTIC * dr.square(way.path + far * eta)
        by_area = c1 * dr.rcp(c2 * dr.maximum(dr.abs(ntt * nbb - ntb * ntb), dr.maximum(least, 1e-20)))
        return dr.select(distant, by_angle, by_area)
