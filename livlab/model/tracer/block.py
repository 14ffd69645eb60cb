"""A block of layers under a beam, by the tracer: what a virtual spectrometer reads.

Paths start where the beam falls in; what leaves the top is read by its direction and its place. What comes to the
block's sides or its bottom is lost, as it is in the walk in plane layers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.shapes import box
from livlab.model.tissue.stack import OpticalStack
from livlab.model.tracer.body import Body
from livlab.model.tracer.lights import Lights
from livlab.model.tracer.stage import surface
from livlab.model.tracer.tracer import Rays, Tracer
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.geometry import Readout
from livlab.model.transport.rng import uniform
from livlab.model.transport.source import Source
from livlab.units import FloatArray

SPACING_MM = 0.5
DEEPEST_SIDES = 10.0
"""Depth, in sides, from below which no light comes back to the face."""

ENDLESS_MM = 200.0
"""Half width and depth that stand for endless ones."""

PIXELS = 1024
"""Rows of the film a launch, whose scatter is the error."""


@dataclass(frozen=True, eq=False)
class TopDistances:
    """Depth below the plane z = 0 on a grid of two by two columns, beyond which its values hold on."""

    origin_mm: FloatArray
    spacing_mm: float
    values: NDArray[np.float32]

    @classmethod
    def of(cls, deepest_mm: float) -> TopDistances:
        """The field from one cell above the plane to a depth."""
        low = -SPACING_MM * (math.ceil(deepest_mm / SPACING_MM) + 1)
        z = np.arange(low, 1.5 * SPACING_MM, SPACING_MM)
        values = np.broadcast_to(-z[:, None, None], (len(z), 2, 2)).astype(np.float32)
        return cls(np.array([-0.5 * SPACING_MM, -0.5 * SPACING_MM, low]), SPACING_MM, values)


class Block:
    """What an instrument reads of a square sample, at all wavelengths from the same paths.

    Parameters
    ----------
    stack
        Its layers.
    view
        The instrument: a beam, one bin of exit angles, any number of bins of the distance from the origin.
    estimator, variant
        As the tracer's.

    Raises
    ------
    InputError
        Diffuse light, or several bins of angles.
    """

    def __init__(self, stack: OpticalStack, view: Readout, estimator: str, variant: str) -> None:
        if view.source.kind != "collimated" or len(view.tally.theta) != 2:
            raise InputError.of(
                "instrument", view.source.kind, "the tracer reads a beam's light in one cone", "Use solver 'walk'."
            )
        mi = mitsuba(variant)
        half = ENDLESS_MM if view.half_width_mm is None else view.half_width_mm
        depth = min(sum(x.thickness_mm for x in stack.layers), max(2.0, DEEPEST_SIDES * 2.0 * half), ENDLESS_MM)
        # The mesh is larger than the sample: what passes the sample's own sides never comes to the mesh's. Off its
        # middle, where two triangles meet: a ray right on their edge may pass between them.
        mesh = box((4.0 * half, 4.0 * half, 1.5 * depth), (0.5 * half, 0.3 * half, -0.75 * depth))
        # A plane is flat as far as it goes.
        self.tracer = t = Tracer(
            {"type": "scene", "block": surface(mi, mesh, smooth=False)},
            stack.wavelength_nm,
            Body(stack, "block", TopDistances.of(depth), patch_mm=depth),
            estimator=estimator,
            variant=variant,
            rays=lambda d, mi: _rays(d, mi, view.source),
            shape=(1, PIXELS),
        )
        t.context.fence = _fence(t, half, depth)
        t.context.lights = _Sensor(t, view)
        self.most, self.paths = float(np.max(np.abs(view.weights))), 0

    def launch(self, samples: int, seed: int, number: int) -> tuple[FloatArray, FloatArray, int, int]:
        """Follow about `samples` paths.

        Returns
        -------
        (W,) sums over rows of the reading and of its square, the rows, and the paths of a row.
        """
        each = max(1, samples // PIXELS)
        total, squares = self.tracer.launch(1, each, seed, number)
        self.paths += PIXELS * each
        return total.sum(axis=0), squares.sum(axis=0), PIXELS, each

    def given_up(self) -> FloatArray:
        """(W,) bound of what the mean of all launches lacks for paths given up: none could have told more than most."""
        return np.asarray(self.tracer.given_up.weight.sum(axis=0) * self.most / max(self.paths, 1))


class _Sensor(Lights):
    """Surroundings as bright as the instrument's weight for light that leaves there."""

    def __init__(self, tracer: Tracer, view: Readout) -> None:
        super().__init__(tracer.d, tracer.mi, tracer.scene, tracer.wavelengths, tracer.padded)
        d, mi = tracer.d, tracer.mi
        self.edges = [d.dr.opaque(mi.Float, min(x, 1e30)) for x in view.tally.radius]
        self.weights = d.load(mi.Float, np.append(view.weights[0], 0.0))
        self.least = d.dr.opaque(mi.Float, math.cos(view.tally.theta[-1]) if view.tally.theta_edges else 0.0)

    def surrounding(self, s: Any, active: Any) -> list[Any]:
        """Nothing for what the first surface mirrored, which has not made a step inside."""
        dr, mi = self.dr, self.mi
        told = active & (s.steps > 1) & (s.d.z > self.least)
        radius = dr.sqrt(dr.fma(s.p.x, s.p.x, s.p.y * s.p.y))
        last = len(self.edges) - 1
        cell = dr.full(mi.UInt32, last, dr.width(s.row))
        for k in range(last):
            cell = dr.select((radius >= self.edges[k]) & (radius < self.edges[k + 1]), mi.UInt32(k), cell)
        seen = dr.select(told, dr.gather(mi.Float, self.weights, cell, told), 0.0)
        return [seen for _ in self.wavelengths]


def _rays(d: Any, mi: Any, source: Source) -> Rays:
    """The beam's rays, a little above the face they fall on."""
    dr = d.dr
    square, disc = (dr.opaque(mi.Float, x) for x in (source.square_half_width_mm, source.disc_radius_mm))
    # As the walk has it, light comes from the side of x < 0.
    down = [math.sin(source.angle_rad), 0.0, -math.cos(source.angle_rad)]
    along = [dr.opaque(mi.Float, x) for x in down]

    def cast(stream: Any, pixel: Any) -> tuple[Any, Any]:
        def draw() -> Any:
            return uniform(d, stream.next_uint32())

        x, y = (square * (2.0 * draw() - 1.0) for _ in range(2))
        if source.disc_radius_mm > 0.0:
            r, turn = disc * dr.sqrt(draw()), 2.0 * math.pi * draw()
            x, y = r * dr.cos(turn), r * dr.sin(turn)
        direction = mi.Vector3f(*along)
        return mi.Point3f(x, y, 0.0) - direction * dr.opaque(mi.Float, 0.1), direction

    return cast


def _fence(tracer: Tracer, half: float, depth: float) -> Callable[[Any], Any]:
    """Whether a place is beyond the sample's sides or bottom."""
    dr, mi = tracer.dr, tracer.mi
    side, bottom = dr.opaque(mi.Float, half), dr.opaque(mi.Float, -depth)

    def beyond(p: Any) -> Any:
        return (dr.abs(p.x) > side) | (dr.abs(p.y) > side) | (p.z < bottom)

    return beyond
