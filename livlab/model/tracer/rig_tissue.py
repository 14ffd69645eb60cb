"""Pictures of a sphere of tissue under distant lights, all of them from the same paths.

A smooth surface bends light, so no path can be aimed at a small light: it is hit by chance. But all that a sphere on
the camera's axis does is the same after a turn about that axis. So each path of the tracer, from the camera through
the tissue and out, is kept with the direction in which it left, and then turned until it meets a light: it serves the
light of every picture, and falls into the pixel that the turn brings it to.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tracer.body import Body
from livlab.model.tracer.lights import LampWeight, Lights
from livlab.model.tracer.tracer import Rays, Tracer
from livlab.model.transport.rng import uniform
from livlab.units import FloatArray

CELLS = 128
"""Cells of a sphere's distance field along its diameter."""

PASS_PATHS = 1 << 18
GOLDEN = 0.6180339887498949


@dataclass(frozen=True, eq=False)
class SphereDistances:
    """Distance to a sphere on a grid: exact at its points, and between them short of it by at most h²/8r."""

    origin_mm: FloatArray
    spacing_mm: float
    values: NDArray[np.float32]

    @classmethod
    def of(cls, radius_mm: float) -> SphereDistances:
        """The field of a sphere about the origin, two cells wider than it on every side."""
        spacing = 2.0 * radius_mm / CELLS
        line = (np.arange(CELLS + 5) - (CELLS + 4) / 2) * spacing
        squared = line[:, None, None] ** 2 + line[None, :, None] ** 2 + line[None, None, :] ** 2
        return cls(np.full(3, line[0]), spacing, (radius_mm - np.sqrt(squared)).astype(np.float32))


@dataclass(frozen=True, eq=False)
class Exits:
    """Paths from a camera on the +z axis that entered a sphere about the origin.

    Attributes
    ----------
    radius
        (N,) where the path began, as a share of the outline's radius in the picture; even over the disc.
    azimuth
        (N,) where it began, about the axis.
    direction
        (N, 3) in which it left; 0 where it did not.
    weight
        (N, W) radiance that the camera sees for a radiance of 1 in that direction.
    seconds, troubles
        What it took, and how many paths were given up or strayed.
    given_up
        (W,) weight that given-up paths still had, as a share of that of all paths: of evenly lit tissue no more than
        this is missing, over one less it (see `livlab.model.tracer.given_up`).
    """

    radius: FloatArray
    azimuth: FloatArray
    direction: FloatArray
    weight: FloatArray
    seconds: float
    troubles: int
    given_up: FloatArray


def exits(
    stack: OpticalStack,
    radius_mm: float,
    distance_mm: float,
    paths: int,
    *,
    seed: int = 0,
    variant: Literal["llvm", "cuda"] = "llvm",
    progress: Callable[[float], None] | None = None,
) -> Exits:
    """Follow paths from a camera into a sphere of tissue until they leave it.

    Parameters
    ----------
    stack
        The tissue's layers; the last fills the sphere.
    radius_mm, distance_mm
        Radius of the sphere, and distance of the eye from its centre; infinite for a parallel camera.
    paths
        Wanted number, rounded up to whole passes.

    Raises
    ------
    InputError
        Layers above the last that are as thick as the sphere.
    EnvironmentProblem
        Mitsuba or the variant cannot run here.
    """
    import time

    started = time.perf_counter()
    depth = sum(x.thickness_mm for x in stack.layers[:-1])
    if not depth < radius_mm:
        raise InputError.of(
            "radius_mm", radius_mm, f"the layers above the last reach {depth:g} mm deep", "Take a larger sphere."
        )
    sphere = _Sphere(stack, radius_mm, distance_mm, min(paths, PASS_PATHS), variant)
    passes = math.ceil(paths / sphere.rows)
    parts = []
    for k in range(passes):
        parts.append(sphere.run(seed, k))
        if progress is not None:
            progress((k + 1) / passes)
    columns = len(stack.wavelength_nm)
    every = np.concatenate(parts)
    weight = every[:, :columns].astype(np.float64)
    first = np.where(weight[:, 0] > 0, weight[:, 0], 1.0)
    # Channels beyond the tissue's repeat its first wavelength, lit by 2 + d: their ratio to it tells d.
    direction = every[:, columns : columns + 3].astype(np.float64) / first[:, None] - 2.0
    left = weight[:, 0] > 0
    direction = np.where(left[:, None], direction, 0.0)
    row = np.tile(np.arange(sphere.rows), passes)
    return Exits(
        np.sqrt((row + 0.5) / sphere.rows),
        2 * np.pi * np.mod((row + 0.5) * GOLDEN, 1.0),
        direction,
        weight,
        time.perf_counter() - started,
        sum(sphere.tracer.troubles.values()),
        sphere.tracer.given_up.weight[:, :columns].sum(axis=0) / len(row),
    )


class _Sphere:
    """The tracer on a sphere of tissue, its film a list of paths."""

    def __init__(self, stack: OpticalStack, radius: float, distance: float, rows: int, backend: str) -> None:
        self.rows = rows
        wide = _with_direction(stack)
        self.tracer = Tracer(
            {"type": "scene", "ball": {"type": "sphere", "radius": float(radius)}},
            wide.wavelength_nm,
            Body(wide, ("ball",), distances=SphereDistances.of(radius)),
            variant=f"{backend}_ad_spectral",
            rays=lambda d, mi: _rays(d, mi, radius, distance, rows),
            shape=(1, rows),
        )
        t = self.tracer
        t.context.lights = _Directions(t.d, t.mi, t.scene, t.wavelengths, t.padded)

    def run(self, seed: int, batch: int) -> NDArray[np.float32]:
        """(rows, padded) what each path's film holds."""
        return np.array(self.tracer.film(1, 1, seed, batch)).reshape(self.rows, self.tracer.padded)


def _rays(d: Any, mi: Any, radius: float, distance: float, rows: int) -> Rays:
    """Rays from an eye on the +z axis, even over the outline's disc, one ring a row."""
    dr = d.dr
    count = dr.opaque(mi.Float, float(rows))
    far = math.isinf(distance)
    start = dr.opaque(mi.Float, 2.0 * radius if far else distance)
    widest = dr.opaque(mi.Float, radius if far else radius / math.sqrt(distance**2 - radius**2))

    def cast(stream: Any, row: Any) -> tuple[Any, Any]:
        turn = (mi.Float(row) + 0.5) * GOLDEN
        angle = 2.0 * math.pi * (turn - dr.floor(turn))
        rho = widest * dr.sqrt((mi.Float(row) + uniform(d, stream.next_uint32())) / count)
        x, y = rho * dr.cos(angle), rho * dr.sin(angle)
        if far:
            return mi.Point3f(x, y, start), mi.Vector3f(0.0, 0.0, -1.0)
        return mi.Point3f(0.0, 0.0, start), dr.normalize(mi.Vector3f(x, y, -1.0))

    return cast


class _Directions(Lights):
    """Surroundings that tell in which direction a path left the tissue: 1 in its own channels, 2 + d in three more."""

    def surrounding(self, s: Any, active: Any) -> list[Any]:
        """Nothing where the path was mirrored by the surface and never entered."""
        dr, mi = self.dr, self.mi
        inside = mi.Float(0.0)
        for path in s.throughput.lengths:
            inside = inside + path
        told = active & (inside > 0.0)
        one = [1.0] * (len(self.wavelengths) - 3)
        return [dr.select(told, x, 0.0) for x in (*one, 2.0 + s.d.x, 2.0 + s.d.y, 2.0 + s.d.z)]

    def emitted(self, hit: Any, active: Any, weight: LampWeight | None = None) -> list[Any]:
        """There are no lamps."""
        return [self.mi.Float(0.0) for _ in self.wavelengths]


def _with_direction(stack: OpticalStack) -> OpticalStack:
    """The stack with its first wavelength three times more, under wavelengths that only have to differ."""
    index = [*range(len(stack.wavelength_nm)), 0, 0, 0]
    wide = stack.at(index)
    return replace(wide, wavelength_nm=np.asarray(400.0 + np.arange(len(index)), dtype=np.float64))


def pictures(
    found: Exits,
    angles: Sequence[tuple[float, float]],
    half_angle: float,
    outline_px: float,
    centre_px: tuple[float, float],
    size: tuple[int, int],
    *,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """One picture a light from the paths of all, turned about the axis until they meet it.

    A light is a disc of the sky of a half-angle δ and even radiance 1 / (π sin² δ), so that a surface that faces it has
    an irradiance of 1. A path whose exit lies at a polar angle that the disc reaches meets it in turns over an arc
    2 γ: it counts γ/π of its weight, in the pixel that a turn drawn from that arc brings it to.

    Parameters
    ----------
    angles
        (polar angle from the axis, azimuth) of each light in radians.
    outline_px, centre_px, size
        Radius of the outline, where the axis is (u, v), and (height, width).

    Returns
    -------
    (L, height, width, W) arrays
        Radiance and its standard error.
    """
    rng = np.random.default_rng(seed)
    polar = np.arccos(np.clip(found.direction[:, 2], -1.0, 1.0))
    azimuth = np.arctan2(found.direction[:, 1], found.direction[:, 0])
    left = found.weight[:, 0] > 0
    reach = [left & (np.abs(polar - a) < half_angle) for a, _ in angles]
    claims = np.sum(reach, axis=0)
    # A path that several lights could use goes to one of them, so that pictures err independently.
    drawn = np.floor(rng.random(len(polar)) * np.maximum(claims, 1))
    height, width = size
    columns = found.weight.shape[1]
    value = np.zeros((len(angles), height * width, columns))
    square = np.zeros_like(value)
    radiance = 1.0 / (math.pi * math.sin(half_angle) ** 2)
    share = math.pi * outline_px**2 / len(polar)
    seen = np.zeros(len(polar))
    for k, (angle, around) in enumerate(angles):
        mine = np.flatnonzero(reach[k] & (seen == drawn))
        seen += reach[k]
        arc = _half_arc(polar[mine], angle, half_angle)
        turn = around - azimuth[mine] + arc * (2 * rng.random(len(mine)) - 1)
        at = found.azimuth[mine] + turn
        rho = found.radius[mine] * outline_px
        column = np.rint(centre_px[0] + rho * np.cos(at)).astype(int)
        row = np.rint(centre_px[1] - rho * np.sin(at)).astype(int)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        pixel = (row * width + column)[inside]
        part = found.weight[mine] * (arc / np.pi * claims[mine] * radiance * share)[:, None]
        for w in range(columns):
            value[k, :, w] = np.bincount(pixel, part[inside, w], minlength=height * width)
            square[k, :, w] = np.bincount(pixel, part[inside, w] ** 2, minlength=height * width)
    shape = (len(angles), height, width, columns)
    return value.reshape(shape), np.sqrt(square).reshape(shape)


def _half_arc(polar: FloatArray, angle: float, half_angle: float) -> FloatArray:
    """Half the arc of azimuth over which a direction at a polar angle lies within a disc of the sky."""
    across = np.sin(polar) * math.sin(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (math.cos(half_angle) - np.cos(polar) * math.cos(angle)) / across
    return np.asarray(np.arccos(np.clip(np.where(across > 0, cosine, -1.0), -1.0, 1.0)))
