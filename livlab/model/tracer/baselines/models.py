"""Older models of appearance in the tissue's place, under the scene's own light: what a tissue is compared with.

Lambert, Blinn–Phong and Ashikhmin–Shirley over Lambert are lit directly and once; Jensen's dipole gathers the light
that enters the surface nearby (Nunes 2019, chapter 5). None of them knows layers: their spectra are those of the
tissue they stand for. Lights are taken as equal at all wavelengths.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tracer.baselines.dipole import DipoleValues
from livlab.model.tracer.baselines.optics import BaselineOptics
from livlab.model.tracer.baselines.pixels import PixelMeans, Values, estimate
from livlab.model.tracer.variant import mitsuba
from livlab.units import FloatArray

BaselineName = Literal["lambert", "blinn-phong", "ashikhmin-shirley", "dipole"]


def render_baseline(
    scene: Any,
    surfaces: str | Sequence[str],
    name: BaselineName,
    optics: BaselineOptics,
    *,
    spp: int = 64,
    seed: int = 0,
    exponent: float = 60.0,
    gloss: FloatArray | None = None,
    as_printed: bool = False,
    mm_per_unit: float = 1.0,
    hide_lights: bool = True,
    variant: str | None = None,
    on_pass: Callable[[float], None] | None = None,
) -> xr.Dataset:
    """Picture of a scene with an older model in the place of the tissue, at all wavelengths from one set of paths.

    Parameters
    ----------
    scene
        A Mitsuba scene with one sensor, or its dict. Other objects keep their material, lit directly and once, the
        same at all wavelengths; mirrors and glass come out black.
    surfaces
        Names (ids) of the shapes that take the model; the dipole joins what enters any of them.
    name
        "lambert": ρ/π (Nunes 2019, eq. 5.1). "blinn-phong": ρ/π + s c (n·h)^α, c so that a white lobe reflects all
        light at normal incidence (eq. 5.2, 5.3). "ashikhmin-shirley": ρ/π + S of eq. 5.8, its Fresnel term Schlick's.
        "dipole": eq. 5.4, 5.5 with r² + z² (Jensen et al. 2001), the area integral sampled through probe rays along
        three axes (King et al. 2013), without single scattering or gloss.
    optics
        Spectra of the material.
    spp, seed
        Samples a pixel, and the seed.
    exponent
        α of Blinn–Phong, n of Ashikhmin–Shirley.
    gloss
        (W,) s of Blinn–Phong, F₀ of Ashikhmin–Shirley; `optics.normal_reflectance` if not given.
    as_printed
        Blinn–Phong: radiance ρ n·l + s (n·h)^α for a light of irradiance π, which is neither reciprocal nor
        normalised (eq. 5.2). Ashikhmin–Shirley: ρ (1/π + S), the lobe tinted too (eq. 5.7). No effect on the others.
    mm_per_unit
        Length of the scene's unit.
    hide_lights
        Whether lights in view stay black.
    variant
        Mitsuba's variant; the one that is set, or `llvm_ad_mono`. It must be a monochromatic one.
    on_pass
        Called with the share done, 0 to 1, after each pass; it may raise to stop.

    Returns
    -------
    Dataset. Dims (row, column, wavelength): `radiance`, `radiance_se`. Attributes: name, samples, seed, variant,
    seconds, exponent, notes.

    Raises
    ------
    InputError
        An unknown model or shape, a bad number, or a variant with colours.
    EnvironmentProblem
        The variant cannot run here.
    """
    mi = mitsuba(variant)
    if not (mi.variant().startswith(("llvm", "cuda")) and "mono" in mi.variant() and "polarized" not in mi.variant()):
        raise InputError.of("variant", mi.variant(), "must be monochromatic and compiled", 'Write "llvm_ad_mono".')
    if name not in get_args(BaselineName):
        raise InputError.of("baseline", name, f"must be one of {', '.join(get_args(BaselineName))}", "Pick one.")
    for what, value, low in (("spp", spp, 2), ("exponent", exponent, 0), ("mm_per_unit", mm_per_unit, 1e-9)):
        if not (math.isfinite(value) and value >= low):
            raise InputError.of(what, value, f"must be finite and at least {low:g}", "Mend the number.")
    started = time.perf_counter()
    world = mi.load_dict(scene, optimize=False) if isinstance(scene, Mapping) else scene
    shapes = _shapes(world, (surfaces,) if isinstance(surfaces, str) else surfaces)
    gloss = optics.normal_reflectance if gloss is None else np.broadcast_to(gloss, optics.n.shape)
    values: Values
    if name == "dipole":
        values = DipoleValues(mi, world, shapes, optics, mm_per_unit)
        weights = np.eye(len(optics.wavelength_nm))
    else:
        values = LobeValues(mi, name, float(exponent), as_printed)
        weights = _weights(name, optics.reflectance, np.asarray(gloss), as_printed)
    found = estimate(mi, world, shapes, values, spp=int(spp), seed=seed, hide_lights=hide_lights, on_pass=on_pass)
    radiance, error = _combined(found, weights)
    over = ("row", "column", "wavelength")
    return xr.Dataset(
        {
            "radiance": (over, radiance, {"units": "radiance of the lights"}),
            "radiance_se": (over, error, {"units": "radiance of the lights"}),
        },
        coords={"wavelength": ("wavelength", optics.wavelength_nm, {"units": "nm"})},
        attrs={
            "baseline": name,
            "samples": int(spp),
            "seed": seed,
            "variant": mi.variant(),
            "seconds": time.perf_counter() - started,
            "exponent": exponent,
            "notes": values.note,
        },
    )


class LobeValues:
    """Reflected radiance of a surface point for one light sample, as terms that wavelengths only weigh."""

    full = True
    note = "direct light, reflected once"

    def __init__(self, mi: Any, name: str, exponent: float, as_printed: bool) -> None:
        import drjit as dr

        self.mi, self.dr, self.name, self.as_printed = mi, dr, name, as_printed
        self.exponent = dr.opaque(mi.Float, exponent)
        m = exponent
        albedo_one = (m + 2.0) * (m + 4.0) / (8.0 * math.pi * (math.exp2(-0.5 * m) + m))
        scale = {"blinn-phong": 1.0 if as_printed else albedo_one, "ashikhmin-shirley": (m + 1.0) / (8.0 * math.pi)}
        self.scale = dr.opaque(mi.Float, scale.get(name, 0.0))
        self.terms = {"lambert": 1, "blinn-phong": 2, "ashikhmin-shirley": 3}[name]

    def __call__(self, scene: Any, si: Any, sampler: Any, active: Any) -> list[Any]:
        """Values (terms,) of one light sample at hits on the body."""
        light, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, active)
        to_light = si.to_local(light.d)
        lit = active & (light.pdf != 0.0) & (si.wi.z > 0.0) & (to_light.z > 0.0)
        return [self.dr.select(lit, x * weight[0], 0.0) for x in self.lobes(to_light, si.wi)]

    def lobes(self, wi: Any, wo: Any) -> list[Any]:
        """BRDF times the light's cosine of every term; `wi` to the light, `wo` to the eye, z the normal."""
        dr = self.dr
        terms = [wi.z / math.pi]
        if self.name == "lambert":
            return terms
        half = dr.normalize(wi + wo)
        lobe = self.scale * dr.power(dr.maximum(half.z, 0.0), self.exponent)
        if self.name == "blinn-phong":
            return [*terms, lobe / math.pi if self.as_printed else lobe * wi.z]
        tilt = dr.dot(wo, half)
        lobe = lobe * wi.z / (tilt * dr.maximum(wi.z, wo.z))
        return [*terms, lobe, lobe * (1.0 - tilt) ** 5]


def _weights(name: str, albedo: FloatArray, gloss: FloatArray, as_printed: bool) -> FloatArray:
    """(terms, W) what each term counts at each wavelength."""
    if name == "lambert":
        return albedo[None]
    if name == "blinn-phong":
        return np.stack([albedo, gloss])
    tint = albedo if as_printed else np.ones_like(albedo)
    return np.stack([albedo, tint * gloss, tint * (1.0 - gloss)])


def _combined(found: PixelMeans, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(row, column, W) radiance and standard error; what does not belong to the body is the last term."""
    radiance = found.mean[..., :-1] @ weights + found.mean[..., -1:]
    if found.covariance is None:
        variance = found.variance[..., :-1] + found.variance[..., -1:]
    else:
        every = np.concatenate([weights, np.ones((1, weights.shape[1]))])
        variance = np.einsum("iw,rcij,jw->rcw", every, found.covariance, every, optimize=True)
    return radiance, np.sqrt(np.maximum(variance, 0.0))


def _shapes(scene: Any, names: Sequence[str]) -> list[Any]:
    known = {s.id(): s for s in scene.shapes()}
    for name in names:
        if name not in known:
            raise InputError.of("surfaces", name, f"names no shape; there are {', '.join(known)}", "Name one of them.")
    return [known[name] for name in names]
