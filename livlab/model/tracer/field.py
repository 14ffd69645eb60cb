"""Depth below a surface and its direction, from a grid of distances, on Dr.Jit arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tracer.body import Distances

TRUST = 0.02
"""Part of a cell by which an interpolated distance may exceed the true one: h²/8R at R = 6 cells."""


@dataclass(frozen=True)
class Field:
    """A distance field on the device, in units of the scene.

    Attributes
    ----------
    values
        Distances, x running fastest.
    slack
        What is taken off an interpolated distance before it counts as clear.
    """

    dr: Any
    mi: Any
    values: Any
    origin: Any
    inverse_spacing: Any
    size: Any
    strides: Any
    slack: float
    deepest: float
    extent: float

    @classmethod
    def load(cls, mi: Any, dr: Any, distances: Distances, mm_per_unit: float) -> Field:
        """Copy a field to the device.

        Raises
        ------
        InputError
            Values that are not a finite 3-D array with at least two points a side.
        """
        values = np.ascontiguousarray(distances.values, dtype=np.float32)
        if values.ndim != 3 or min(values.shape) < 2 or not np.isfinite(values).all():
            raise InputError.of("distances.values", values.shape, "must be a finite 3-D array", "Make the field anew.")
        spacing = float(distances.spacing_mm) / mm_per_unit
        origin = np.asarray(distances.origin_mm, dtype=np.float64) / mm_per_unit
        data = mi.Float(values.ravel() / np.float32(mm_per_unit)) + 0.0  # + 0: Dr.Jit's own, aligned memory
        dr.eval(data)
        nz, ny, nx = values.shape
        return cls(
            dr=dr,
            mi=mi,
            values=data,
            origin=mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in origin)),
            inverse_spacing=dr.opaque(mi.Float, 1.0 / spacing),
            size=[dr.opaque(mi.Float, float(n - 2)) for n in (nx, ny, nz)],
            strides=[dr.opaque(mi.UInt32, int(n)) for n in (nx, nx * ny)],
            slack=TRUST * spacing,
            deepest=float(values.max()) / mm_per_unit,
            extent=float(max(nx, ny, nz) - 1) * spacing,
        )

    def look(self, p: Any, active: Any) -> tuple[Any, Any]:
        """Depth at a point and the unit vector in which it grows, by trilinear interpolation."""
        dr, mi = self.dr, self.mi
        q = (p - self.origin) * self.inverse_spacing
        base, part = [], []
        for axis in range(3):
            cell = dr.clip(dr.floor(q[axis]), 0.0, self.size[axis])
            base.append(mi.UInt32(cell))
            part.append(dr.clip(q[axis] - cell, 0.0, 1.0))
        row, plane = self.strides
        at = base[0] + base[1] * row + base[2] * plane
        corner = {
            (i, j, k): dr.gather(mi.Float, self.values, at + i + j * row + k * plane, active)
            for i in (0, 1)
            for j in (0, 1)
            for k in (0, 1)
        }
        u, v, w = part
        along = {(j, k): dr.lerp(corner[0, j, k], corner[1, j, k], u) for j in (0, 1) for k in (0, 1)}
        slope = {(j, k): corner[1, j, k] - corner[0, j, k] for j in (0, 1) for k in (0, 1)}
        low, high = dr.lerp(along[0, 0], along[1, 0], v), dr.lerp(along[0, 1], along[1, 1], v)
        gradient = mi.Vector3f(
            dr.lerp(dr.lerp(slope[0, 0], slope[1, 0], v), dr.lerp(slope[0, 1], slope[1, 1], v), w),
            dr.lerp(along[1, 0] - along[0, 0], along[1, 1] - along[0, 1], w),
            high - low,
        )
        length = dr.squared_norm(gradient)
        unit = dr.select(length > 0.0, gradient * dr.rsqrt(length), mi.Vector3f(0.0, 0.0, 1.0))
        return dr.lerp(low, high, w), unit
