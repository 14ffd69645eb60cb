"""What pictures of a sphere say about the lights that made them: one isotropic reflectance, shared by all pictures.

Under the right lights one function of the local directions explains every picture up to its light's strength. The
function is free: a sum of diffuse terms and lobes, none of them held to be true, whose weights are least squares.
So a misfit speaks of the lights and not of the material, as far as the sum can follow the material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from livlab.acquire.photographs.outline import FloatArray
from livlab.brdf.geometry import Camera, Light, Sphere

ROUGHNESS = (0.04, 0.08, 0.16, 0.32, 0.6)
"""Of the lobes; the widths of real ones lie between."""

LEAST_PIXELS = 60
"""Usable pixels below which a picture is not judged."""

_RIDGE = 1e-7
_SIDE = 6
"""Patches across the disc: residuals of neighbours hang together, those of patches hardly."""

Placed = tuple[FloatArray, FloatArray]
"""Directions (lights, pixels, 3) to the lights, and what they send there (lights, pixels) over what reaches the
centre."""


@dataclass(frozen=True, eq=False)
class Shading:
    """Some pixels of each picture, and what they see of the sphere.

    Attributes
    ----------
    points_mm, normals, eye
        (n, 3) where the pixels look, the normal there, and the direction to the eye; world frame.
    value, variance
        (lights, n) radiance over the light's strength as declared; NaN where not usable, or not known.
    weight
        (lights, n) of squared residuals: 1 / (median level + value)², so that a highlight counts by its relative error.
    patch
        (n,) number of the patch of the disc.
    lights, camera, sphere
        As declared.
    kept
        (lights,) numbers of the pictures that have enough usable pixels.
    """

    points_mm: FloatArray
    normals: FloatArray
    eye: FloatArray
    value: FloatArray
    variance: FloatArray
    weight: FloatArray
    patch: NDArray[np.intp]
    lights: tuple[Light, ...]
    camera: Camera
    sphere: Sphere
    kept: tuple[int, ...]

    @property
    def centre_mm(self) -> FloatArray:
        """Of the sphere."""
        return self.sphere.centre_mm

    def placed(self, lights: Sequence[Light]) -> Placed:
        """How each pixel is lit by lights."""
        towards = np.empty((len(lights), len(self.normals), 3))
        scale = np.empty((len(lights), len(self.normals)))
        for k, light in enumerate(lights):
            towards[k], scale[k] = light.at(self.points_mm)
            scale[k] /= light.at(self.centre_mm)[1]
        return towards, scale

    def directions(self, lights: Sequence[Light]) -> FloatArray:
        """Unit vectors (lights, 3) from the sphere's centre."""
        return np.array([light.at(self.centre_mm)[0] for light in lights])


def shading(
    camera: Camera,
    sphere: Sphere,
    lights: Sequence[Light],
    pixels: tuple[FloatArray, FloatArray, FloatArray],
    values: Sequence[FloatArray],
    variances: Sequence[FloatArray],
) -> Shading | None:
    """Pixels made ready to be judged; None where no picture has enough of them.

    Parameters
    ----------
    camera, sphere, lights
        As declared.
    pixels
        (n, 3) points, normals and unit directions to the eye of the pixels.
    values, variances
        For each light (n,) radiance and its variance.
    """
    points, normals, eye = pixels
    strength = np.array([float(light.intensity.mean()) * light.at(sphere.centre_mm)[1] for light in lights])
    value = np.array(values, dtype=np.float64) / strength[:, None]
    variance = np.array(variances, dtype=np.float64) / strength[:, None] ** 2
    usable = np.isfinite(value)
    kept = [k for k in range(len(lights)) if usable[k].sum() >= LEAST_PIXELS and np.nanmax(value[k]) > 0]
    if not kept:
        return None
    value, variance, usable = value[kept], variance[kept], usable[kept]
    level = np.array([np.mean(np.clip(v[u], 0, np.quantile(v[u], 0.9))) for v, u in zip(value, usable, strict=True)])
    level = np.maximum(level, 1e-12)
    weight = np.where(usable, 1 / (level[:, None] + np.clip(np.nan_to_num(value), 0, None)) ** 2, 0.0)
    # In units of each picture's level, so that a bright light counts no more than a dim one.
    weight *= (level[:, None] ** 2) * 4
    across = normals @ camera.rotation.T
    cell = np.clip(((across[:, :2] + 1) / 2 * _SIDE).astype(int), 0, _SIDE - 1)
    patch = np.unique(cell[:, 0] * _SIDE + cell[:, 1], return_inverse=True)[1]
    return Shading(
        points_mm=points,
        normals=normals,
        eye=eye,
        value=np.nan_to_num(value),
        variance=variance,
        weight=weight / level[:, None] ** 2,
        patch=patch.ravel(),
        lights=tuple(lights[k] for k in kept),
        camera=camera,
        sphere=sphere,
        kept=tuple(kept),
    )


def terms(seen: Shading, placed: Placed) -> FloatArray:
    """Radiance (lights, pixels, terms) of each term of the reflectance under lights of strength 1.

    A constant (stray light); n.l times 1, n.l, n.v and Oren & Nayar's term; microfacet lobes (GGX with V-cavities,
    Walter et al. 2007, eq. 33; Cook & Torrance 1982) of several widths, and three with Schlick's Fresnel factor.
    """
    towards, scale = placed
    n, e = seen.normals[None], seen.eye[None]
    raw = np.einsum("kpi,kpi->kp", towards, np.broadcast_to(n, towards.shape))
    cos_i = np.clip(raw, 0.0, None)
    cos_o = np.clip(np.einsum("pi,pi->p", seen.normals, seen.eye), 0.05, None)[None]
    le = np.einsum("kpi,kpi->kp", towards, np.broadcast_to(e, towards.shape))
    half_length = np.sqrt(np.maximum(2 + 2 * le, 1e-9))
    nh = np.clip((raw + cos_o) / half_length, 0.0, 1.0)
    lh = np.sqrt(np.clip((1 + le) / 2, 1e-6, 1.0))
    s = le - cos_i * cos_o
    oren = cos_i * np.where(s > 0, s / np.maximum(np.maximum(cos_i, cos_o), 1e-6), s)
    shadow = np.minimum(1.0, 2 * nh * np.minimum(cos_i, cos_o) / lh) / (4 * cos_o)
    columns = [np.ones_like(cos_i), cos_i * scale, cos_i**2 * scale, cos_i * cos_o * scale, oren * scale]
    schlick = (1 - lh) ** 5
    for k, alpha in enumerate(ROUGHNESS):
        lobe = alpha**2 / (np.pi * (1 - nh**2 * (1 - alpha**2)) ** 2) * shadow * np.where(raw > 0, scale, 0.0)
        columns.append(lobe)
        if k % 2:
            columns.append(lobe * schlick)
    return np.stack(columns, axis=-1)


@dataclass(frozen=True, eq=False)
class SharedFit:
    """The shared reflectance at its best under some lights.

    Attributes
    ----------
    weights
        (terms,) of the reflectance.
    gain
        (lights,) strength that each picture asks for, over the declared one; their geometric mean is 1.
    residual
        (lights, pixels) value minus prediction, times the root of the weight.
    predicted
        (lights, pixels).
    rss
        (lights,) sum of the squared residuals.
    """

    weights: FloatArray
    gain: FloatArray
    residual: FloatArray
    predicted: FloatArray
    rss: FloatArray

    @property
    def total(self) -> float:
        """Sum of squared residuals of all pictures."""
        return float(self.rss.sum())


def fit_shared(
    seen: Shading, basis: FloatArray, gain: FloatArray | None = None, *, free: bool = True, rounds: int = 12
) -> SharedFit:
    """Weights shared by all pictures and a gain for each, by least squares in turn.

    Parameters
    ----------
    seen, basis
        The pixels, and `terms` under the lights that are tried.
    gain
        Gains to begin with.
    free
        Whether gains are fitted, too.
    rounds
        At most.
    """
    w = seen.weight
    weighted = basis * w[..., None]
    gram = np.matmul(weighted.transpose(0, 2, 1), basis)
    right = np.einsum("kpt,kp->kt", weighted, seen.value)
    size = np.sqrt(np.maximum(np.einsum("ktt->t", gram), 1e-300))
    gram, right = gram / (size[:, None] * size), right / size
    g = np.ones(len(w)) if gain is None else gain.copy()
    c = np.zeros(basis.shape[2])
    for _ in range(rounds if free else 1):
        normal = np.einsum("k,ktu->tu", g**2, gram)
        normal[np.diag_indices_from(normal)] += _RIDGE * max(float(np.trace(normal)), 1e-300)
        c = np.linalg.solve(normal, g @ right)
        if not free:
            break
        power = np.einsum("t,ktu,u->k", c, gram, c)
        new = np.clip(np.divide(right @ c, power, out=np.ones_like(g), where=power > 0), 1e-3, 1e3)
        new /= np.exp(np.mean(np.log(new)))
        done = np.max(np.abs(np.log(new / g))) < 1e-4
        g = new
        if done:
            break
    predicted = g[:, None] * (basis @ (c / size))
    residual = (seen.value - predicted) * np.sqrt(w)
    return SharedFit(c / size, g, residual, predicted, np.einsum("kp,kp->k", residual, residual))


def crossed(seen: Shading, basis: FloatArray, weights: FloatArray) -> FloatArray:
    """Misfit (pictures, lights) of each picture under each light's place, each with its best gain."""
    made = basis @ weights
    return _best_gain(seen, made)


def _best_gain(seen: Shading, made: FloatArray) -> FloatArray:
    """Misfit (pictures, predictions) with the best gain that is not negative."""
    own = np.einsum("kp,kp->k", seen.weight, seen.value**2)
    both = np.clip((seen.weight * seen.value) @ made.T, 0, None)
    power = np.maximum(seen.weight @ (made**2).T, 1e-300)
    return np.asarray(own[:, None] - both**2 / power)


def patch_sums(seen: Shading, values: FloatArray) -> FloatArray:
    """Sums (lights, patches) of values (lights, pixels) over the patches."""
    count = int(seen.patch.max()) + 1
    out = np.zeros((len(values), count))
    for b in range(count):
        out[:, b] = values[:, seen.patch == b].sum(axis=1)
    return out


def tangents_of(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (lights, 3) across each direction and each other."""
    helper = np.where(np.abs(directions[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(directions, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(directions, first)


def moved_to(light: Light, direction: FloatArray, centre_mm: FloatArray) -> Light:
    """The light in another direction from the sphere, a near one as far away as before."""
    if light.position_mm is None:
        return Light(light.intensity, direction, None, light.solid_angle_sr)
    far = float(np.linalg.norm(light.position_mm - centre_mm))
    return Light(light.intensity, None, centre_mm + far * direction, light.solid_angle_sr)


@dataclass(frozen=True, eq=False)
class Tilts:
    """How far each picture asks its light to be turned.

    Attributes
    ----------
    direction
        (lights, 3) where the shading puts the light.
    angle_rad, sd_rad
        (lights,) angle from where it was tried, and the standard error of the direction in its worse tilt.
    z
        (lights,) that angle over its own standard error.
    """

    direction: FloatArray
    angle_rad: FloatArray
    sd_rad: FloatArray
    z: FloatArray


def tilts(seen: Shading, lights: Sequence[Light], weights: FloatArray, *, rounds: int = 6) -> Tilts:
    """Where each picture puts its light under a known reflectance: Gauss–Newton in two tilts and the gain.

    Standard errors take whole patches of the disc as what errs alike (a sandwich of their sums).
    """
    first, second = tangents_of(seen.directions(lights))
    start = seen.directions(lights)
    at = np.zeros((len(lights), 2))
    step = 0.01

    def made(shift: FloatArray) -> FloatArray:
        turned = start + shift[:, :1] * first + shift[:, 1:] * second
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        moved = [moved_to(x, d, seen.centre_mm) for x, d in zip(lights, turned, strict=True)]
        return np.asarray(terms(seen, seen.placed(moved)) @ weights)

    root = np.sqrt(seen.weight)
    covariance = np.zeros((len(lights), 2, 2))
    damping = np.full(len(lights), 1e-3)
    best = np.full(len(lights), np.inf)
    kept = at.copy()
    for turn in range(rounds + 1):
        base = made(at)
        power = np.maximum(np.einsum("kp,kp->k", seen.weight, base**2), 1e-300)
        gain = np.clip(np.einsum("kp,kp->k", seen.weight * seen.value, base) / power, 0, None)
        residual = (seen.value - gain[:, None] * base) * root
        cost = np.einsum("kp,kp->k", residual, residual)
        better = cost < best
        kept[better], best = at[better], np.minimum(cost, best)
        damping = np.where(better, damping / 5, damping * 20)
        if turn == rounds:
            break
        slopes = [(made(kept + step * e) - made(kept - step * e)) / (2 * step) for e in np.eye(2)]
        base = made(kept)
        gain = np.clip(
            np.einsum("kp,kp->k", seen.weight * seen.value, base)
            / np.maximum(np.einsum("kp,kp->k", seen.weight, base**2), 1e-300),
            0,
            None,
        )
        residual = (seen.value - gain[:, None] * base) * root
        jacobian = np.stack([*(gain[:, None] * s * root for s in slopes), base * root], axis=-1)
        normal = np.matmul(jacobian.transpose(0, 2, 1), jacobian)
        diagonal = np.einsum("kii->ki", normal)
        lifted = normal + np.einsum(
            "ki,ij->kij", damping[:, None] * diagonal + 1e-12 * diagonal.max() + 1e-300, np.eye(3)
        )
        move = np.linalg.solve(lifted, np.einsum("kpi,kp->ki", jacobian, residual)[..., None])[:, :2, 0]
        length = np.linalg.norm(move, axis=1, keepdims=True)
        move *= np.minimum(1.0, 0.3 / np.maximum(length, 1e-12))
        at = kept + move
        covariance = _sandwich(seen, jacobian, residual, normal)
    turned = start + kept[:, :1] * first + kept[:, 1:] * second
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    angle = np.arccos(np.clip(np.einsum("ki,ki->k", turned, start), -1, 1))
    sd = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, -1], 0))
    z = np.sqrt(np.einsum("ki,kij,kj->k", kept, np.linalg.pinv(covariance + 1e-10 * np.eye(2)), kept))
    return Tilts(turned, angle, sd, z)


def _sandwich(seen: Shading, jacobian: FloatArray, residual: FloatArray, normal: FloatArray) -> FloatArray:
    """Covariance (lights, 2, 2) of the tilts, robust to residuals that hang together within patches."""
    count = int(seen.patch.max()) + 1
    scores = np.stack(
        [np.einsum("kpi,kp->ki", jacobian[:, seen.patch == b], residual[:, seen.patch == b]) for b in range(count)]
    )
    meat = np.einsum("bki,bkj->kij", scores, scores) * count / max(count - 3, 1)
    inverse = np.linalg.pinv(normal)
    return np.asarray((inverse @ meat @ inverse)[:, :2, :2])
