"""Light sources of a scene at the picture's wavelengths.

Mitsuba evaluates four wavelengths at a time. A source whose spectrum is the same everywhere is therefore evaluated
once for its spectrum, and in the loop at one wavelength only, for how much of it arrives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from livlab.errors import InputError
from livlab.model.tracer.medium import packet
from livlab.model.transport.device import Device
from livlab.units import FloatArray

GROUP = 4

LEVEL_SAMPLES = 64
"""Points of a lamp, or directions of the environment, that tell how much light there is."""

LampWeight = Callable[[Any], Any]
"""From a lamp's number to the MIS weight of its light."""


class Lights:
    """The sources of a scene.

    Attributes
    ----------
    lamps
        Sources that a scattering inside a tissue samples: all but the environment.
    environment
        The source that surrounds the scene, or None.
    """

    def __init__(self, d: Device, mi: Any, scene: Any, wavelengths: FloatArray, padded: int) -> None:
        self.d, self.mi, self.dr, self.scene = d, mi, d.dr, scene
        self.wavelengths, self.padded = np.asarray(wavelengths, dtype=np.float64), padded
        self.all: list[Any] = list(scene.emitters())
        self.environment = next((e for e in self.all if e.is_environment()), None)
        self.lamps = [e for e in self.all if not e.is_environment()]
        self.surfaces = [e for e in self.lamps if mi.has_flag(e.flags(), mi.EmitterFlags.Surface)]
        spectra, references = [], []
        self.textured = [bool(mi.has_flag(e.flags(), mi.EmitterFlags.SpatiallyVarying)) for e in self.all]
        for e, textured in zip(self.all, self.textured, strict=True):
            values = np.ones(len(self.wavelengths)) if textured else self._spectrum(e)
            best = int(np.argmax(values))
            spectra.append(values / values[best] if values[best] > 0 else 0.0 * values)
            references.append(float(self.wavelengths[best]))
        table = np.zeros((max(1, len(self.all)), padded))
        for k, values in enumerate(spectra):
            table[k, : len(values)] = values
        self.spectra = d.load(mi.Float, table)
        self.references = d.load(mi.Float, references or [float(self.wavelengths[0])])
        self.reference = references
        ids = [int(self.dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(e))[0]) for e in self.all]
        numbers = np.zeros(max(ids, default=0) + 1)
        for k, i in enumerate(ids):
            numbers[i] = k
        self.number_of = d.load(mi.UInt32, numbers.astype(int))
        self.grid = [d.dr.opaque(mi.Float, float(x)) for x in self.wavelengths]
        self.dr.make_opaque(self.spectra, self.references, self.number_of)

    def _spectrum(self, emitter: Any) -> FloatArray:
        """What a source sends to some place, a value a wavelength; only ratios matter."""
        mi = self.mi
        values: list[float] = []
        for group in groups(self.wavelengths.tolist()):
            if mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface) or emitter.is_environment():
                si = self.dr.zeros(mi.SurfaceInteraction3f)
                si.wavelengths = mi.UnpolarizedSpectrum(*group)
                si.wi = mi.Vector3f(0.0, 0.0, 1.0)
                found = emitter.eval(si)
            else:
                it = self.dr.zeros(mi.Interaction3f)
                it.p = self._before(emitter)
                it.wavelengths = mi.UnpolarizedSpectrum(*group)
                _, found = emitter.sample_direction(it, mi.Point2f(0.5, 0.5))
            values += [float(found[k][0]) for k in range(GROUP)]
        values = values[: len(self.wavelengths)]
        if not np.isfinite(values).all() or min(values) < 0:
            raise InputError.of(f"emitter {emitter.id()!r}", values, "must be finite and >= 0", "Mend its spectrum.")
        return np.array(values)

    def _before(self, emitter: Any) -> Any:
        """A place that the source lights: ahead of it, if it has an ahead."""
        place = self.mi.traverse(emitter)
        try:
            to_world = place["to_world"]
        except KeyError:
            return self.mi.Point3f(self.scene.bbox().center())
        matrix = np.array(to_world.matrix, dtype=np.float64).reshape(4, 4)
        return self.mi.Point3f(*(matrix[:3, 3] + matrix[:3, 2]).tolist())

    def emission(self, number: Any, strength: Any) -> list[Any]:
        """Strength of a source at every wavelength, from that at its own reference."""
        found = packet(self.mi, self.dr, self.spectra, number, self.padded)
        return [found[w] * strength for w in range(len(self.wavelengths))]

    def seen(self, s: Any, missed: Any, lamp: Any, hit: Any, weight: LampWeight | None = None) -> list[Any]:
        """Radiance that a ray has come to outside, a value a wavelength; of a lamp, with its MIS weight."""
        around, lamps = self.surrounding(s, missed), self.emitted(hit, lamp, weight)
        return [x + y for x, y in zip(around, lamps, strict=True)]

    def surrounding(self, s: Any, active: Any) -> list[Any]:
        """Radiance of the environment along a lane's ray, a value a wavelength; 0 where not active."""
        dr, mi = self.dr, self.mi
        if self.environment is None:
            return [mi.Float(0.0) for _ in self.wavelengths]
        k = next(i for i, e in enumerate(self.all) if e.is_environment())
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = -s.d
        if not self.textured[k]:
            si.wavelengths = mi.UnpolarizedSpectrum(dr.opaque(mi.Float, self.reference[k]))
            found = dr.select(active, self.environment.eval(si, active)[0], 0.0)
            return self.emission(mi.UInt32(k) + dr.zeros(mi.UInt32, dr.width(s.row)), found)
        return self._groups(si, lambda x: self.environment.eval(x, active), active)

    def emitted(self, hit: Any, active: Any, weight: LampWeight | None = None) -> list[Any]:
        """Radiance of a lamp's surface that a ray has hit, a value a wavelength."""
        dr, mi = self.dr, self.mi
        if not self.surfaces:
            return [mi.Float(0.0) for _ in self.wavelengths]
        flags = mi.RayFlags.UV | mi.RayFlags.ShadingFrame
        si = hit.found.compute_surface_interaction(hit.ray, flags, active)
        emitter = si.shape.emitter()
        lit = active & (emitter != None)  # noqa: E711 - Dr.Jit compares elementwise
        number = dr.gather(mi.UInt32, self.number_of, dr.reinterpret_array(mi.UInt32, emitter), lit)
        counts = weight(number) if weight is not None else mi.Float(1.0)
        if any(self.textured[self.all.index(e)] for e in self.surfaces):
            return [x * counts for x in self._groups(si, lambda x: emitter.eval(x, lit), lit)]
        si.wavelengths = mi.UnpolarizedSpectrum(dr.gather(mi.Float, self.references, number, lit))
        found = dr.select(lit, emitter.eval(si, lit)[0] * counts, 0.0)
        return self.emission(number, found)

    def arriving(self, lamp: Any, it: Any, sample: Any, active: Any) -> tuple[list[Any], Any]:
        """What a lamp sends to a place at each wavelength, over the density of the sample; and the way to it."""
        dr, mi = self.dr, self.mi
        k = self.all.index(lamp)
        if self.textured[k]:
            out: list[Any] = []
            for group in groups(self.grid):
                it.wavelengths = mi.UnpolarizedSpectrum(*group)
                ds, found = lamp.sample_direction(it, sample, active)
                out += [found[j] for j in range(GROUP)]
            return out[: len(self.wavelengths)], ds
        it.wavelengths = mi.UnpolarizedSpectrum(dr.opaque(mi.Float, self.reference[k]))
        ds, found = lamp.sample_direction(it, sample, active)
        return self.emission(mi.UInt32(k) + dr.zeros(mi.UInt32, dr.width(active)), found[0]), ds

    def level(self, box: Any) -> FloatArray:
        """(W,) radiance of a white surface that faces every lamp, under an environment as bright as its mean.

        The median over places in a box: beside a lamp there is no end to it.
        """
        dr, mi = self.dr, self.mi
        if not self.all:
            return np.zeros(len(self.wavelengths))
        places = np.stack(np.meshgrid(*[(0.25, 0.5, 0.75)] * 3), axis=-1).reshape(-1, 3).repeat(LEVEL_SAMPLES, axis=0)
        low, high = (np.array(x, dtype=np.float64).ravel() for x in (box.min, box.max))
        it = dr.zeros(mi.Interaction3f, len(places))
        it.p = mi.Point3f(*(low + places * (high - low)).T.astype(np.float32))
        line = (np.arange(len(places)) % LEVEL_SAMPLES + 0.5) / LEVEL_SAMPLES
        sample = mi.Point2f(mi.Float(line), mi.Float(np.mod(line * LEVEL_SAMPLES * 0.6180339887498949, 1.0)))
        found = np.zeros((len(places), len(self.wavelengths)))
        for e in self.all:
            solid = 4.0 * np.pi if e.is_environment() else np.pi
            arriving, _ = self.arriving(e, it, sample, dr.full(mi.Bool, True, len(places)))
            found += np.stack([np.array(x, dtype=np.float64) for x in arriving], axis=-1) / solid
        each = np.nan_to_num(found).reshape(-1, LEVEL_SAMPLES, len(self.wavelengths)).mean(axis=1)
        return np.asarray(np.median(each, axis=0))

    def _groups(self, si: Any, value: Any, active: Any) -> list[Any]:
        out: list[Any] = []
        for group in groups(self.grid):
            si.wavelengths = self.mi.UnpolarizedSpectrum(*group)
            found = value(si)
            out += [self.dr.select(active, found[k], 0.0) for k in range(GROUP)]
        return out[: len(self.wavelengths)]


def groups(wavelengths: Sequence[Any]) -> list[list[Any]]:
    """Wavelengths four by four, the last repeated."""
    whole = list(wavelengths)
    whole += [whole[-1]] * (-len(whole) % GROUP)
    return [whole[k : k + GROUP] for k in range(0, len(whole), GROUP)]
