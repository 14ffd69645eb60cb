"""Light that leaves upwards, by exit angle and azimuth: what a goniometer's detector collects."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from livlab.model.transport.device import Device
from livlab.model.transport.tally import FIXED_POINT, Moments, Tally
from livlab.model.transport.walk.observers import End, Step


class Directions:
    """Weight that leaves through the top in each bin of (theta_o, |phi|), summed as integers that all lanes share."""

    def __init__(self, d: Device, tally: Tally, wavelengths: int) -> None:
        self._theta, self._phi = len(tally.theta) - 1, len(tally.phi_edges) - 1
        # Both rise with the angle: −cos θ, and −cos φ with cos φ = −x/|across|, light travelling to +x.
        theta, phi = -np.cos(tally.theta), -np.cos(tally.phi_edges)
        theta[0] = -2.0 if tally.theta[0] == 0.0 else theta[0]
        theta[-1] = 0.0 if tally.theta[-1] >= math.pi / 2 else theta[-1]
        phi[0] = -2.0 if tally.phi_edges[0] == 0.0 else phi[0]
        phi[-1] = 2.0 if tally.phi_edges[-1] >= math.pi * (1 - 1e-12) else phi[-1]
        self._polar, self._azimuth = d.load(d.Float, theta), d.load(d.Float, phi)
        size = self._theta * self._phi * wavelengths
        self._sums = d.dr.zeros(d.Int64, size), d.dr.zeros(d.Int64, size)
        d.dr.make_opaque(self._polar, self._azimuth, self._sums)

    def start(self, d: Device, lanes: int) -> Any:
        """Nothing in registers."""
        return ()

    def step(self, d: Device, state: Any, step: Step) -> Any:
        """Nothing before the exit."""
        return state

    def end(self, d: Device, state: Any, end: End) -> Any:
        """Find the bin and add, in the lanes that leave upwards."""
        dr = d.dr

        def place(edges: Any, count: int, value: Any) -> tuple[Any, Any]:
            found = dr.binary_search(0, count + 1, lambda k: dr.gather(d.Float, edges, k) <= value)
            return found - 1, (found >= 1) & (found <= count)

        def add(leaves: Any, weight: Any, cosine: Any, x: Any, y: Any, wavelength: Any) -> Any:
            t, inside = place(self._polar, self._theta, -cosine)
            length = dr.maximum(dr.sqrt(dr.fma(x, x, y * y)), 1e-20)
            p, within = place(self._azimuth, self._phi, dr.clip(x / length, -1.0, 1.0))
            index = (wavelength * self._theta + t) * self._phi + p
            where = leaves & inside & within
            w = d.Float64(weight)
            dr.scatter_add(self._sums[0], d.Int64(w * FIXED_POINT), index, where)
            dr.scatter_add(self._sums[1], d.Int64(w * w * FIXED_POINT), index, where)
            return leaves

        args = (end.up, end.weight, end.cosine, *end.across, end.wavelength)
        dr.if_stmt(args, end.up, add, lambda leaves, *_: leaves)
        return state

    def result(self, d: Device, state: Any, wavelengths: int, samples: int) -> dict[str, Moments]:
        """(W, θ, φ) for the light that leaves upwards."""
        shape = (wavelengths, self._theta, self._phi)
        total, squares = (np.array(x, dtype=np.float64).reshape(shape) / FIXED_POINT for x in self._sums)
        return {"reflectance_directed": Moments(samples, total, squares)}
