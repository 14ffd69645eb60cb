"""A scene made ready: its shapes, lights and camera, the tissue's tables, and the kernel that follows paths in it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.tracer.body import Body
from livlab.model.tracer.context import MAX_BOUNCES, Context, TracerOptions
from livlab.model.tracer.field import Field
from livlab.model.tracer.flight import Flights
from livlab.model.tracer.given_up import GivenUp, Leftover
from livlab.model.tracer.kernel import Kernel, LaunchPlan
from livlab.model.tracer.lights import Lights
from livlab.model.tracer.media import media, padded_width
from livlab.model.tracer.medium import Medium
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.device import Device
from livlab.model.transport.rng import streams, uniform
from livlab.units import FloatArray

VARIANT = "llvm_ad_spectral"
LANES = {"llvm": 1 << 14, "cuda": 1 << 20}
"""Paths in flight: enough for every core, few enough to stay in cache."""

FILM_BYTES = 1 << 28
"""Rows of a launch that are kept at once."""

Rays = Callable[[Any, Any], tuple[Any, Any]]
"""From a random stream and a pixel's number to the origin and direction of its ray."""


class Tracer:
    """Follows paths in one scene.

    Parameters
    ----------
    scene
        A scene as `mitsuba.load_dict` takes it, or a loaded one of the same variant.
    wavelengths_nm
        (W,) wavelengths; those of the body's stack.
    body
        The tissue; None: a scene without.
    sensor
        Which of the scene's cameras.
    estimator
        "expected" or "analog".
    variant
        A spectral variant of Mitsuba.
    max_steps, max_bounces
        Steps, and objects hit, after which a path is given up.
    next_event
        Whether scatterings in the tissue sample the lamps; if not, lamps are hit by chance, points and beams never.
    rays, shape
        In place of a camera: what casts rays, and the rows and columns it casts them for.

    Raises
    ------
    InputError
        A scene without camera, a surface that is none of its shapes, wavelengths that are not the stack's, a variant
        without spectra.
    EnvironmentProblem
        The variant cannot run here.
    """

    def __init__(
        self,
        scene: Mapping[str, Any] | Any,
        wavelengths_nm: FloatArray,
        body: Body | None = None,
        *,
        sensor: int = 0,
        estimator: str = "expected",
        variant: str = VARIANT,
        max_steps: int = 100_000,
        max_bounces: int = MAX_BOUNCES,
        next_event: bool = True,
        rays: Callable[[Device, Any], Rays] | None = None,
        shape: tuple[int, int] | None = None,
    ) -> None:
        self.wavelengths = np.asarray(wavelengths_nm, dtype=np.float64)
        self.variant = variant
        limits = {"max_steps": max_steps, "max_bounces": max_bounces}
        _check(self.wavelengths, body, estimator, variant, limits)
        self.mi = mi = mitsuba(variant)
        import drjit as dr

        self.dr = dr
        self.backend = variant.split("_", maxsplit=1)[0]
        self.d = d = Device.of("cuda" if self.backend == "cuda" else "llvm", dr, mi)
        self.scene = _loaded(mi, scene)
        self.shapes = _surfaces(self.scene, body)
        size = 1.0 if body is None else float(max(self.shapes[0].bbox().extents()))
        self.medium: Medium | None = None
        self.flights: Flights | None = None
        if body is not None:
            self.medium, self.flights = _tissue(d, mi, body, size)
        self.padded = padded_width(len(self.wavelengths))
        lights = Lights(d, mi, self.scene, self.wavelengths, self.padded)
        if rays is None:
            self.shape, cast = self._camera(sensor)
        else:
            assert shape is not None
            self.shape, cast = shape, rays(d, mi)
        self.pixels = self.shape[0] * self.shape[1]
        within = body is not None and self._within(cast)
        pixels = dr.opaque(mi.UInt32, self.pixels)
        self.context = Context(
            d,
            mi,
            self.scene,
            shapes=self.shapes,
            medium=self.medium,
            flights=self.flights,
            lights=lights,
            camera=lambda stream, row: cast(stream, row % pixels),
            size=size,
            options=TracerOptions(estimator=estimator, camera_within=within, next_event=next_event, **limits),
        )
        self.kernel = Kernel(self.context)
        self.troubles = {"given_up": 0, "strayed": 0}
        self.given_up = GivenUp.none(self.pixels, len(self.wavelengths))
        self.seconds = self.compile_seconds = 0.0

    def _within(self, cast: Rays) -> bool:
        """Whether a ray may start inside the body: in the box around it."""
        dr, mi, n = self.dr, self.mi, 4096
        stream = streams(self.d, n, 0, 0)
        origin, _ = cast(stream, dr.arange(mi.UInt32, n) % dr.opaque(mi.UInt32, self.pixels))
        box, inside = self.shapes[0].bbox(), dr.full(mi.Bool, True, n)
        for axis in range(3):
            inside &= (origin[axis] >= box.min[axis]) & (origin[axis] <= box.max[axis])
        return bool(dr.any(inside))

    def most_rows(self) -> int:
        """Rows that one launch can hold."""
        return max(1, FILM_BYTES // (4 * self.padded * self.pixels))

    def launch(self, rows: int, samples: int, seed: int, number: int) -> tuple[FloatArray, FloatArray]:
        """Follow `samples` paths for each of `rows` rows of every pixel.

        Returns
        -------
        (pixel, W) sum over the rows of their mean radiance, and of its square.
        """
        film = self.film(rows, samples, seed, number)
        started = time.perf_counter()
        total, squares = self._sums(film, rows, samples)
        width = len(self.wavelengths)
        shape = (self.pixels, self.padded)
        sums = tuple(np.array(x, dtype=np.float64).reshape(shape)[:, :width] for x in (total, squares))
        self.seconds += time.perf_counter() - started
        return sums[0], sums[1]

    def film(self, rows: int, samples: int, seed: int, number: int) -> Any:
        """The launch's film: for each row, pixel and padded wavelength the sum over its samples."""
        dr, mi = self.dr, self.mi
        started = time.perf_counter()
        count = rows * self.pixels
        lanes = min(LANES[self.backend], count)
        film = dr.zeros(mi.Float, count * self.padded)
        leftover = Leftover(mi, dr, pixels=self.pixels, padded=self.padded, paths_a_pixel=float(rows * samples))
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            strayed = self.kernel.trace(film, LaunchPlan(count, lanes, samples, leftover), seed, number)
            dr.sync_thread()
            history = dr.kernel_history()
        self.compile_seconds += 1e-3 * sum(h.get("codegen_time", 0.0) + h.get("backend_time", 0.0) for h in history)
        given_up = leftover.read(len(self.wavelengths))
        self.given_up.add(given_up)
        self.troubles["given_up"] += given_up.paths
        self.troubles["strayed"] += int(np.array(strayed).astype(np.int64).sum())
        self.seconds += time.perf_counter() - started
        return film

    @cached_property
    def level(self) -> FloatArray:
        """(W,) radiance of a white surface under the scene's lights, in the body's place if there is one."""
        return self.context.lights.level(self.shapes[0].bbox() if self.shapes else self.scene.bbox())

    def take_given_up(self) -> GivenUp:
        """What was given up since it was last taken."""
        taken, self.given_up = self.given_up, GivenUp.none(self.pixels, len(self.wavelengths))
        options = self.context.options
        taken.max_steps, taken.max_bounces = options.max_steps, options.max_bounces
        return taken

    def _sums(self, film: Any, rows: int, samples: int) -> tuple[Any, Any]:
        """Sums over the rows of a film, in double precision: a pixel may have 10⁵ rows."""
        dr, mi = self.dr, self.mi
        size = self.pixels * self.padded
        index = dr.arange(mi.UInt32, size)
        end = dr.opaque(mi.UInt32, rows * size)
        step, scale = dr.opaque(mi.UInt32, size), dr.opaque(mi.Float64, 1.0 / samples)
        zero = dr.zeros(mi.Float64, size)

        def add(at: Any, total: Any, squares: Any) -> tuple[Any, Any, Any]:
            value = mi.Float64(dr.gather(mi.Float, film, at)) * scale
            return at + step, total + value, dr.fma(value, value, squares)

        _, total, squares = dr.while_loop(
            (index, zero, zero + 0.0), lambda at, *_: at < end, add, label="rows", mode="symbolic"
        )
        dr.eval(total, squares)
        return total, squares

    def sees_body(self) -> NDArray[np.bool_]:
        """(row, column) pixels in whose middle the camera sees the body."""
        dr, mi = self.dr, self.mi
        pixel = dr.arange(mi.UInt32, self.pixels)
        stream = _Middle(mi)
        origin, direction = self.context.camera(stream, pixel)
        hit = self.context.surface.intersect(mi.Ray3f(origin, direction), mi.Bool(True))
        return np.array(hit.body + dr.zeros(mi.UInt32, self.pixels)).astype(bool).reshape(self.shape)

    def _camera(self, sensor: int) -> tuple[tuple[int, int], Rays]:
        mi, dr, d = self.mi, self.dr, self.d
        lenses = self.scene.sensors()
        if not 0 <= sensor < len(lenses):
            raise InputError.of("sensor", sensor, f"the scene has {len(lenses)} cameras", "Add one, or name another.")
        lens = lenses[sensor]
        columns, rows = (int(x) for x in lens.film().crop_size())
        width = dr.opaque(mi.UInt32, columns)
        across, down = dr.opaque(mi.Float, 1.0 / columns), dr.opaque(mi.Float, 1.0 / rows)
        aperture = lens.needs_aperture_sample()

        def cast(stream: Any, pixel: Any) -> tuple[Any, Any]:
            row = pixel // width
            column = pixel - row * width
            u, v = uniform(d, stream.next_uint32()), uniform(d, stream.next_uint32())
            place = mi.Point2f((mi.Float(column) + u) * across, (mi.Float(row) + v) * down)
            lens_place = mi.Point2f(0.5, 0.5)
            if aperture:
                lens_place = mi.Point2f(uniform(d, stream.next_uint32()), uniform(d, stream.next_uint32()))
            ray, _ = lens.sample_ray(mi.Float(0.0), mi.Float(0.5), place, lens_place)
            return ray.o, ray.d

        return (rows, columns), cast


class _Middle:
    """A random stream that is always in the middle."""

    def __init__(self, mi: Any) -> None:
        self.mi = mi

    def next_uint32(self) -> Any:
        """Half of the range."""
        return self.mi.UInt32(1 << 31)


def _loaded(mi: Any, scene: Mapping[str, Any] | Any) -> Any:
    """The scene, if it is not loaded yet."""
    if not isinstance(scene, Mapping):
        return scene
    try:
        return mi.load_dict(dict(scene), optimize=False)
    except (RuntimeError, ValueError, TypeError) as error:
        raise InputError.of("scene", "", f"is not taken by Mitsuba ({error})", "Mend it.") from error


def _tissue(d: Device, mi: Any, body: Body, size: float) -> tuple[Medium, Flights]:
    """A body's tissue on the device, and free flights in it."""
    field = Field.load(mi, d.dr, body.distances, body.mm_per_unit) if body.distances is not None else None
    deepest = field.deepest * body.mm_per_unit if field and not body.nested else 0.0
    made = media(body.stack, mm_per_unit=body.mm_per_unit, room_mm=deepest, split=body.nested, hollow=body.hollow)
    medium = Medium(d, mi, made)
    return medium, Flights(medium, body, field, size)


def _surfaces(scene: Any, body: Body | None) -> list[Any]:
    shapes = []
    for name in body.surfaces if body is not None else ():
        found = [s for s in scene.shapes() if s.id() == name]
        if len(found) != 1:
            known = ", ".join(repr(s.id()) for s in scene.shapes())
            raise InputError.of("surfaces", name, f"is not one of the scene's shapes ({known})", "Name one of them.")
        shapes.append(found[0])
    return shapes


def _check(wavelengths: FloatArray, body: Body | None, estimator: str, variant: str, most: Mapping[str, int]) -> None:
    if wavelengths.ndim != 1 or not wavelengths.size or not (np.isfinite(wavelengths) & (wavelengths > 0)).all():
        raise InputError.of("wavelengths_nm", wavelengths, "must be positive numbers", "Give them in nm.")
    if body is not None and not np.array_equal(body.stack.wavelength_nm, wavelengths):
        raise InputError.of(
            "wavelengths_nm", wavelengths, "must be the stack's wavelengths", "Make the stack at these wavelengths."
        )
    if estimator not in {"expected", "analog"}:
        raise InputError.of("estimator", estimator, "must be 'expected' or 'analog'", "Name one of the two.")
    if "spectral" not in variant or "polarized" in variant or variant.startswith("scalar"):
        raise InputError.of(
            "variant", variant, "must be a compiled spectral one", "Use 'llvm_ad_spectral' or 'cuda_ad_spectral'."
        )
    for name, value in most.items():
        if not 1 <= value < 1 << 30:
            raise InputError.of(name, value, f"must be within [1, {(1 << 30) - 1}]", "Allow at least one.")
