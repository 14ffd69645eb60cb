"""Pictures of a scene with a body of tissue, at any number of wavelengths, with the error of every pixel."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from livlab.errors import InputError
from livlab.model.tracer.body import Body
from livlab.model.tracer.field import Field
from livlab.model.tracer.flight import Flights
from livlab.model.tracer.kernel import Kernel, Plan
from livlab.model.tracer.lights import Lights
from livlab.model.tracer.media import media
from livlab.model.tracer.medium import Medium
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.device import Device
from livlab.model.transport.rng import uniform

VARIANT = "llvm_ad_spectral"
LANES = {"llvm": 1 << 14, "cuda": 1 << 20}


def render(
    scene: Mapping[str, Any] | Any,
    wavelengths_nm: Sequence[float],
    *,
    body: Body | None = None,
    spp: int = 16,
    seed: int = 0,
    estimator: str = "expected",
    sensor: int = 0,
    variant: str = VARIANT,
    max_steps: int = 100_000,
    passes: int = 4,
    mirrored: int = 1,
) -> xr.Dataset:
    """Radiance that a camera sees.

    Parameters
    ----------
    scene
        A scene as `mitsuba.load_dict` takes it, or a loaded one of the same variant. The body's surfaces are shapes
        of it, named by their keys; their BSDF is not used.
    wavelengths_nm
        (W,) wavelengths; those of the body's stack.
    body
        The tissue; None: a scene without.
    spp
        Samples a pixel; each serves all wavelengths.
    seed
        Natural number.

    Returns
    -------
    xr.Dataset
        radiance and its standard error radiance_se on (row, column, wavelength).
    """
    started = time.perf_counter()
    mi = mitsuba(variant)
    import drjit as dr

    d = Device("llvm", dr, mi.Float, mi.Float64, mi.UInt32, mi.UInt64, mi.Int32, mi.Int64, mi.Bool, mi.PCG32)
    loaded = mi.load_dict(dict(scene), optimize=False) if isinstance(scene, Mapping) else scene
    lens = loaded.sensors()[sensor]
    columns, rows_ = (int(x) for x in lens.film().crop_size())
    pixels = rows_ * columns
    shapes: list[Any] = []
    medium, flights, size = None, None, 1.0
    grid = np.asarray(wavelengths_nm, dtype=float)
    if body is not None:
        for name in body.surfaces:
            found = [s for s in loaded.shapes() if s.id() == name]
            if len(found) != 1:
                raise InputError.of("surfaces", name, "is no shape of the scene", "Name a shape by its key.")
            shapes.append(found[0])
        bbox = shapes[0].bbox()
        size = float(max(bbox.extents()))
        field = Field.load(mi, dr, body.distances, body.mm_per_unit) if body.distances is not None else None
        room = field.deepest * body.mm_per_unit if field and not body.nested else 0.0
        m = media(body.stack, mm_per_unit=body.mm_per_unit, room_mm=room, split=body.nested, hollow=body.hollow)
        medium = Medium(d, mi, m)
        flights = Flights(medium, body, field, size)
    lights = Lights(d, mi, loaded, grid, medium.m.padded if medium else 16)

    def camera(stream: Any, row: Any) -> tuple[Any, Any]:
        pixel = row % dr.opaque(mi.UInt32, pixels)
        w = dr.opaque(mi.UInt32, columns)
        y = pixel // w
        x = pixel - y * w
        pos = mi.Point2f(
            (mi.Float(x) + uniform(d, stream.next_uint32())) / columns,
            (mi.Float(y) + uniform(d, stream.next_uint32())) / rows_,
        )
        ap = mi.Point2f(uniform(d, stream.next_uint32()), uniform(d, stream.next_uint32()))
        ray, _ = lens.sample_ray(mi.Float(0), mi.Float(0.5), pos, ap)
        return ray.o, ray.d

    lanes_max = LANES["llvm"]
    repeat = max(1, -(-lanes_max // pixels))
    film_rows = pixels * repeat
    per = max(1, -(-spp // (passes * repeat)))
    lanes = min(lanes_max, film_rows)
    plan = Plan(film_rows, lanes, pixels, per, mirrored if body else 0, estimator, max_steps)
    kernel = Kernel(d, mi, loaded, medium, flights, shapes, lights, camera, size, plan)
    total = np.zeros((pixels, len(grid)))
    squares = np.zeros_like(total)
    n = 0
    troubles = 0
    for k in range(passes):
        film = dr.zeros(mi.Float, film_rows * lights.padded)
        dr.eval(film)
        t = kernel.trace(film, seed, k)
        got = np.array(film).reshape(repeat, pixels, lights.padded)[:, :, : len(grid)].astype(float) / per
        total += got.sum(0)
        squares += (got**2).sum(0)
        n += repeat
        troubles = troubles + np.array(t).astype(int).sum()
    mean = total / n
    se = np.sqrt(np.maximum(squares / n - mean**2, 0) / max(n - 1, 1))
    shape = (rows_, columns, len(grid))
    out = xr.Dataset(
        {
            "radiance": (("row", "column", "wavelength"), mean.reshape(shape)),
            "radiance_se": (("row", "column", "wavelength"), se.reshape(shape)),
        },
        coords={"wavelength": grid},
    )
    out.attrs = {"samples": n * per, "seconds": time.perf_counter() - started, "troubles": int(troubles)}
    return out
