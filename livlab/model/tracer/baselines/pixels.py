"""Pixels for the older models: where their eye rays hit the scene, and means with errors over the samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from livlab.units import FloatArray

PASS_BYTES = 1 << 28
"""What the values of one pass may take: passes beyond it are summed in double."""

PASS_SAMPLES = 1 << 22


class Values(Protocol):
    """What a model gives back at a hit: `terms` numbers, of which a picture is made."""

    full: bool
    note: str
    terms: int

    def __call__(self, scene: Any, si: Any, sampler: Any, active: Any) -> list[Any]:
        """One sample at the hits that are active; 0 elsewhere."""


@dataclass(frozen=True)
class PixelMeans:
    """PixelMeans over a pixel's samples, the last term being what is not the body's.

    Attributes
    ----------
    mean, variance
        (row, column, terms + 1), the variance being the mean's.
    covariance
        (row, column, terms + 1, terms + 1) of the means, or None where only variances were kept.
    """

    mean: FloatArray
    variance: FloatArray
    covariance: FloatArray | None


def estimate(
    mi: Any,
    scene: Any,
    shapes: Sequence[Any],
    values: Values,
    *,
    spp: int,
    seed: int,
    hide_lights: bool,
    on_pass: Callable[[float], None] | None = None,
) -> PixelMeans:
    """Sample every pixel of the scene's first sensor, uniformly over its area.

    Parameters
    ----------
    shapes
        The body's; `values` is asked there, and every other shape answers with its own material and one light sample.
    """
    film = scene.sensors()[0].film()
    width, height = (int(x) for x in film.size())
    picture = _Picture(mi, scene, shapes, values, (width, height), hide_lights)
    pixels, terms = width * height, values.terms + 1
    most = min(PASS_SAMPLES, PASS_BYTES // (4 * terms))
    sums = np.zeros((terms, pixels))
    products = np.zeros((terms, terms, pixels))
    done, k = 0, 0
    while done < spp:
        # Fewer rows at a time where even one sample a pixel is too much.
        now = min(spp - done, max(1, most // pixels))
        rows = max(1, min(height, most // (width * now)))
        for first in range(0, height, rows):
            count = min(rows, height - first)
            got = picture.sample(first, count, now, (seed * 8191 + k) % 2**32)
            here = slice(first * width, (first + count) * width)
            sums[:, here] += got.sum(axis=2)
            for i in range(terms):
                for j in range(i, terms) if values.full else (i,):
                    products[i, j, here] += np.einsum("ps,ps->p", got[i], got[j])
            k += 1
            if on_pass is not None:
                on_pass((done + now * (first + count) / height) / spp)
        done += now
    mean = sums / spp
    shape = (height, width)
    spread = products / spp - mean[:, None] * mean[None, :] if values.full else None
    own = np.array([products[i, i] / spp - mean[i] ** 2 for i in range(terms)])
    scale = 1.0 / max(spp - 1, 1)
    covariance = None
    if spread is not None:
        upper = np.triu(np.ones((terms, terms), dtype=bool))[..., None]
        spread = np.where(upper, spread, spread.transpose(1, 0, 2)) * scale
        covariance = np.moveaxis(spread.reshape(terms, terms, *shape), (0, 1), (2, 3))
    return PixelMeans(
        np.moveaxis(mean.reshape(terms, *shape), 0, 2),
        np.moveaxis((own * scale).reshape(terms, *shape), 0, 2),
        covariance,
    )


def member(mi: Any, shape: Any, shapes: Sequence[Any]) -> Any:
    """Whether hits lie on one of the shapes."""
    found = shape == mi.ShapePtr(shapes[0])
    for other in shapes[1:]:
        found |= shape == mi.ShapePtr(other)
    return found


@dataclass(frozen=True, eq=False)
class _Picture:
    """What is sampled: a scene through its first sensor, a body of some shapes in it, and the body's model."""

    mi: Any
    scene: Any
    shapes: Sequence[Any]
    values: Values
    size: tuple[int, int]
    hide_lights: bool

    def sample(self, first: int, count: int, spp: int, seed: int) -> FloatArray:
        """(terms, pixels, spp) values of `count` rows from the first."""
        import drjit as dr

        mi, scene, (width, height) = self.mi, self.scene, self.size
        pixels = count * width
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, pixels * spp)
        pixel = dr.arange(mi.UInt32, pixels * spp) // dr.opaque(mi.UInt32, spp)
        row = pixel // dr.opaque(mi.UInt32, width)
        column = pixel - row * dr.opaque(mi.UInt32, width)
        at = mi.Point2f(mi.Float(column), mi.Float(row + dr.opaque(mi.UInt32, first))) + sampler.next_2d()
        at = at / mi.Point2f(dr.opaque(mi.Float, width), dr.opaque(mi.Float, height))
        ray, weight = scene.sensors()[0].sample_ray(0.0, sampler.next_1d(), at, sampler.next_2d())
        si = scene.ray_intersect(ray)
        body = si.is_valid() & member(mi, si.shape, self.shapes)
        made = [x * weight[0] for x in self.values(scene, si, sampler, body)]
        made.append(self._other(si, ray, sampler, ~body) * weight[0])
        dr.eval(made)
        return np.stack([np.array(x, dtype=np.float64).reshape(pixels, spp) for x in made])

    def _other(self, si: Any, ray: Any, sampler: Any, active: Any) -> Any:
        """Radiance of what is not the body: lights in view, and other objects lit directly and once."""
        import drjit as dr

        mi, scene = self.mi, self.scene
        hit = active & si.is_valid()
        light, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, hit)
        lit = hit & (light.pdf != 0.0)
        value = si.bsdf(ray).eval(mi.BSDFContext(), si, si.to_local(light.d), lit)[0]
        total = dr.select(lit, value * weight[0], 0.0)
        if not self.hide_lights:
            emitter = si.emitter(scene)
            total += dr.select(active & (emitter != None), emitter.eval(si, active)[0], 0.0)  # noqa: E711
        return total
