"""The dipole on any surface: light that enters nearby, gathered by sampling the surface around each point seen.

Jensen, Marschner, Levoy & Hanrahan 2001, eq. 4, 5 (Nunes 2019, eq. 5.4, 5.5): L = F_t(v)/π ∫ R_d(|x_i − x_o|) E_t dA,
E_t the irradiance that enters. A point x_i is found by a probe ray along one of three axes at a random distance from
x_o, and weighed by the chance of all three to find it (King, Kulla, Conty & Fajardo 2013). Distances are drawn from
r R_d(r), the mean over the wavelengths: one draw serves them all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tracer.baselines.optics import BaselineOptics
from livlab.model.tracer.baselines.pixels import member
from livlab.model.transport.diffusion import dipole_profile
from livlab.model.transport.fresnel import diffuse_fresnel

REACH = 16.0
"""Probes reach this many penetration depths 1/σ_tr; what lies beyond is about e⁻¹⁶ of the light."""

MOST_HITS = 32
"""Crossings of the surface that one probe follows."""

RADII = 512
"""Distances at which the density that they are drawn from is tabulated."""

AXES = (0.8, 0.1, 0.1)
"""Chance of a probe along the normal and along each of two tangents."""


@dataclass
class _Probe:
    """A probe on its way along an axis.

    Attributes
    ----------
    step, going
        Crossings so far of any surface, and whether there may be more.
    choice
        The random number that keeps one of the crossings.
    count
        Crossings of the body's surface.
    place, normal, facing
        The one kept, its face's normal and its shading normal.
    """

    ray: Any
    step: Any
    going: Any
    choice: Any
    count: Any
    place: Any
    normal: Any
    facing: Any


class DipoleValues:
    """Radiance that the dipole sends to the eye, one term a wavelength."""

    full = False

    def __init__(self, mi: Any, scene: Any, shapes: Sequence[Any], optics: BaselineOptics, mm_per_unit: float) -> None:
        import drjit as dr

        self.mi, self.dr, self.shapes = mi, dr, shapes
        absorption = np.asarray(optics.absorption) * mm_per_unit
        reduced = np.asarray(optics.reduced_scattering) * mm_per_unit
        transport = absorption + reduced
        if not np.all(transport > 0):
            bound = "must be > 0 somewhere in absorption or scattering"
            raise InputError.of("absorption + reduced_scattering", float(transport.min()), bound, "Name a medium.")
        inside = np.array([diffuse_fresnel(float(a), float(b)) for a, b in zip(optics.n, optics.n_above, strict=True)])
        effective = np.sqrt(3.0 * absorption * transport)
        real = 1.0 / transport
        virtual = real * (1.0 + 4.0 / 3.0 * (1.0 + inside) / (1.0 - inside))
        self.terms = len(transport)

        def one(value: Any) -> Any:
            return dr.opaque(mi.Float, float(value))

        self.effective = [one(x) for x in effective]
        self.poles = [(one(a), one(b)) for a, b in zip(real, virtual, strict=True)]
        self.scale = [one(a) for a in reduced / transport / (4.0 * math.pi)]
        box = scene.bbox()
        widest = float(np.linalg.norm(np.array(box.max) - np.array(box.min)))
        with np.errstate(divide="ignore"):
            depth = np.minimum(1.0 / effective, widest)
        reach = min(REACH * float(depth.max()), widest)
        self.reach = one(reach)
        radius = reach * np.linspace(0.0, 1.0, RADII) ** 3
        profile = [dipole_profile(radius, *x) for x in zip(absorption, reduced, optics.n, optics.n_above, strict=True)]
        wanted = np.array([radius * x / np.trapezoid(radius * x, radius) for x in profile]).mean(axis=0)
        self.radii = mi.IrregularContinuousDistribution(
            mi.Float(radius.astype(np.float32)), mi.Float(wanted.astype(np.float32))
        )
        ratio = np.asarray(optics.n) / np.asarray(optics.n_above)
        low, high = float(ratio.min()), float(ratio.max())
        self.ratios = (one(low), one(high))
        self.between = [one((x - low) / (high - low) if high > low else 0.0) for x in ratio]
        self.note = (
            f"diffusion alone: no single scattering, no gloss; light from beyond {reach * mm_per_unit:.3g} mm left out"
        )

    def __call__(self, scene: Any, si: Any, sampler: Any, active: Any) -> list[Any]:
        """Values (W,) of one probe and one light sample at hits on the body."""
        dr, mi = self.dr, self.mi
        active = active & (si.wi.z > 0.0)
        place, normal, facing, count = self._probe(scene, si, sampler, active)
        found = active & (count > 0)
        there = dr.zeros(mi.SurfaceInteraction3f, dr.width(place))
        there.p, there.n, there.t = place, mi.Normal3f(normal), mi.Float(0.0)
        light, weight = scene.sample_emitter_direction(there, sampler.next_2d(), True, found)
        cosine = dr.dot(light.d, facing)
        lit = found & (light.pdf != 0.0) & (cosine > 0.0) & (dr.dot(light.d, normal) > 0.0)
        distance = dr.norm(place - si.p)
        flux = dr.select(lit, weight[0] * cosine * count / self._density(si, place, normal), 0.0) / math.pi
        enters, leaves = self._transmitted(cosine), self._transmitted(si.wi.z)
        out = []
        for k in range(self.terms):
            profile = mi.Float(0.0)
            for pole in self.poles[k]:
                d = dr.sqrt(distance**2 + pole**2)
                profile += pole * (1.0 + self.effective[k] * d) * dr.exp(-self.effective[k] * d) / d**3
            through = dr.lerp(*enters, self.between[k]) * dr.lerp(*leaves, self.between[k])
            out.append(flux * self.scale[k] * profile * through)
        return out

    def _probe(self, scene: Any, si: Any, sampler: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """A point of the surface, its face's normal, its shading normal, and how many points the probe came to."""
        dr, mi = self.dr, self.mi
        frame = mi.Frame3f(si.n)
        u = sampler.next_1d()
        axis = dr.select(u < AXES[0], frame.n, dr.select(u < AXES[0] + AXES[1], frame.s, frame.t))
        across = mi.Frame3f(axis)
        radius = self.radii.sample(sampler.next_1d(), active)
        turn = 2.0 * math.pi * sampler.next_1d()
        half = dr.safe_sqrt(self.reach**2 - radius**2)
        start = si.p + across.s * (radius * dr.cos(turn)) + across.t * (radius * dr.sin(turn)) + axis * half
        ray = mi.Ray3f(start, -axis)
        ray.maxt = 2.0 * half
        zero = dr.zeros(mi.Vector3f, dr.width(start))
        probe = _Probe(
            ray=ray,
            step=dr.zeros(mi.UInt32, dr.width(start)),
            going=mi.Bool(active),
            choice=sampler.next_1d(),
            count=dr.zeros(mi.Float, dr.width(start)),
            place=zero,
            normal=mi.Vector3f(zero),
            facing=mi.Vector3f(zero),
        )
        probe = dr.while_loop(
            (probe,), lambda p: p.going & (p.step < MOST_HITS), lambda p: (self._onwards(scene, p),), label="probe"
        )[0]
        return probe.place, probe.normal, probe.facing, probe.count

    def _onwards(self, scene: Any, p: _Probe) -> _Probe:
        """Take a probe to its next crossing of the surface, which it keeps with a chance of 1 in all so far."""
        dr, mi = self.dr, self.mi
        hit = scene.ray_intersect(p.ray, p.going)
        p.going &= hit.is_valid()
        here = p.going & member(mi, hit.shape, self.shapes)
        p.count = dr.select(here, p.count + 1.0, p.count)
        # One number decides again and again: given that it was under (over) 1/count, it is uniform there.
        chance = 1.0 / dr.maximum(p.count, 1.0)
        take = here & (p.choice < chance)
        over = (p.choice - chance) / dr.maximum(1.0 - chance, 1e-6)
        p.choice = dr.select(here, dr.select(take, p.choice * p.count, over), p.choice)
        p.place = dr.select(take, hit.p, p.place)
        p.normal = dr.select(take, mi.Vector3f(hit.n), p.normal)
        p.facing = dr.select(take, mi.Vector3f(hit.sh_frame.n), p.facing)
        onward = hit.spawn_ray(p.ray.d)
        onward.maxt = p.ray.maxt - hit.t
        p.ray = dr.select(p.going, onward, p.ray)
        p.step = p.step + 1
        return p

    def _density(self, si: Any, place: Any, normal: Any) -> Any:
        """Chance per area that a probe along any of the axes finds a place."""
        dr, mi = self.dr, self.mi
        frame = mi.Frame3f(si.n)
        apart = place - si.p
        total = mi.Float(0.0)
        for chance, axis in zip(AXES, (mi.Vector3f(frame.n), frame.s, frame.t), strict=True):
            radius = dr.maximum(dr.norm(apart - axis * dr.dot(apart, axis)), 1e-7 * self.reach)
            density = self.radii.eval_pdf_normalized(dr.minimum(radius, self.reach)) / (2.0 * math.pi * radius)
            total += chance * density * dr.abs(dr.dot(normal, axis))
        return dr.maximum(total, 1e-30)

    def _transmitted(self, cosine: Any) -> tuple[Any, Any]:
        """Fresnel's transmittance at the lowest and the highest index; between them it is linear to 1e-6."""
        low, high = (1.0 - self.mi.fresnel(self.dr.clip(cosine, 0.0, 1.0), n)[0] for n in self.ratios)
        return low, high
