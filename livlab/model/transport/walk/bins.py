"""Light that leaves in bins: by exit angle and radius, or by exit angle and azimuth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from livlab.model.transport.device import Device
from livlab.model.transport.tally import FIXED_POINT, SampleMoments, Tally
from livlab.model.transport.walk.observers import End, Step
from livlab.units import FloatArray


class SharedBins:
    """Weight in bins of two quantities, for each of some groups, as integers in memory that all lanes share.

    Attributes
    ----------
    shape
        Groups, bins of the first quantity, bins of the second.
    """

    def __init__(self, d: Device, groups: int, first: FloatArray, second: FloatArray) -> None:
        self.shape = (groups, len(first) - 1, len(second) - 1)
        self._edges = d.load(d.Float, first), d.load(d.Float, second)
        size = math.prod(self.shape)
        self._sums = d.dr.zeros(d.Int64, size), d.dr.zeros(d.Int64, size)
        d.dr.make_opaque(self._edges, self._sums)

    def start(self, d: Device, lanes: int) -> Any:
        """Nothing in registers."""
        return ()

    def step(self, d: Device, state: Any, step: Step) -> Any:
        """Nothing before the exit."""
        return state

    def add(self, d: Device, where: Any, group: Any, values: tuple[Any, Any], weight: Any) -> None:
        """Add in some lanes; light beyond the edges is left out, a second value of None counts as inside."""
        dr = d.dr
        t, inside = self._place(d, 0, values[0])
        r, within = self._place(d, 1, values[1]) if values[1] is not None else (0, True)
        index = (group * self.shape[1] + t) * self.shape[2] + r
        where = where & inside & within
        w = d.Float64(weight)
        dr.scatter_add(self._sums[0], d.Int64(w * FIXED_POINT), index, where)
        dr.scatter_add(self._sums[1], d.Int64(w * w * FIXED_POINT), index, where)

    def sums(self, *shape: int) -> tuple[FloatArray, FloatArray]:
        """Sums and sums of squares, the groups laid out in a shape."""
        total, squares = (
            np.array(x, dtype=np.float64).reshape(*shape, *self.shape[1:]) / FIXED_POINT for x in self._sums
        )
        return total, squares

    def _place(self, d: Device, axis: int, value: Any) -> tuple[Any, Any]:
        """Bin along an axis, and whether there is one."""
        edges, count = self._edges[axis], self.shape[1 + axis]
        found = d.dr.binary_search(0, count + 1, lambda k: d.dr.gather(d.Float, edges, k) <= value)
        return found - 1, (found >= 1) & (found <= count)


class Bins(SharedBins):
    """Reflected and transmitted light by exit angle and radius."""

    def __init__(self, d: Device, tally: Tally, wavelengths: int) -> None:
        super().__init__(d, 2 * wavelengths, tally.minus_cosines, np.asarray(tally.radius))

    def end(self, d: Device, state: Any, end: End) -> Any:
        """Find the bin and add, in the lanes that leave."""
        dr = d.dr

        def add(leaves: Any, up: Any, weight: Any, cosine: Any, radius: Any, wavelength: Any) -> Any:
            group = wavelength * 2 + dr.select(up, d.UInt32(0), d.UInt32(1))
            self.add(d, leaves, group, (-cosine, radius), weight)
            return leaves

        leaves = end.up | end.down
        args = (leaves, end.up, end.weight, end.cosine, end.radius, end.wavelength)
        dr.if_stmt(args, leaves, add, lambda leaves, *_: leaves)
        return state

    def result(self, d: Device, state: Any, wavelengths: int, samples: int) -> dict[str, SampleMoments]:
        """(W, θ, r) for the light that leaves upwards and downwards."""
        total, squares = self.sums(wavelengths, 2)
        return {
            "reflectance_binned": SampleMoments(samples, total[:, 0], squares[:, 0]),
            "transmittance_binned": SampleMoments(samples, total[:, 1], squares[:, 1]),
        }


class Directions(SharedBins):
    """Light that leaves through the top by exit angle and azimuth, left and right alike."""

    def __init__(self, d: Device, tally: Tally, wavelengths: int) -> None:
        # −cos φ rises with the azimuth as −cos θ does with θ; cos φ = −x/|across|, light travelling to +x.
        phi = -np.cos(tally.phi_edges)
        phi[0] = -2.0 if tally.phi_edges[0] == 0.0 else phi[0]
        phi[-1] = 2.0 if tally.phi_edges[-1] >= math.pi * (1 - 1e-12) else phi[-1]
        super().__init__(d, wavelengths, tally.minus_cosines, phi)

    def end(self, d: Device, state: Any, end: End) -> Any:
        """Find the bin and add, in the lanes that leave upwards."""
        dr = d.dr

        def add(leaves: Any, weight: Any, cosine: Any, x: Any, y: Any, wavelength: Any) -> Any:
            length = dr.maximum(dr.sqrt(dr.fma(x, x, y * y)), 1e-20)
            self.add(d, leaves, wavelength, (-cosine, dr.clip(x / length, -1.0, 1.0)), weight)
            return leaves

        args = (end.up, end.weight, end.cosine, *end.across, end.wavelength)
        dr.if_stmt(args, end.up, add, lambda leaves, *_: leaves)
        return state

    def result(self, d: Device, state: Any, wavelengths: int, samples: int) -> dict[str, SampleMoments]:
        """(W, θ, φ) for the light that leaves upwards."""
        return {"reflectance_directed": SampleMoments(samples, *self.sums(wavelengths))}
