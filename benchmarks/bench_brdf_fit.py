"""Seconds and memory from pictures of a sphere to a fitted GGX, and how far the fit is from the truth.

First 96 pictures of 612 x 512 pixels and 16 bit, read light by light; then 12 rendered ones of a radius of 115 pixels;
then what the loss and the pixels' footprint do to a roughness.
By hand:

    python benchmarks/bench_brdf_fit.py
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

import numpy as np
import xarray as xr

from livlab.acquire.instruments.sphere_rig import SphereRig, arc, light, photograph
from livlab.brdf.fit.fit import BrdfFit, Packed, fit, pack
from livlab.brdf.geometry import Camera, Light, Sphere
from livlab.brdf.models.model import Cosines, model
from livlab.brdf.sphere import by_light, extract
from livlab.brdf.view import see

TRUTH = {"kd": 0.4, "ks": 1.0, "alpha": 0.1, "eta": 1.5}


def timed(name: str, work: Callable[[], object]) -> object:
    wall, cpu = time.perf_counter(), time.process_time()
    found = work()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    spent, used = time.perf_counter() - wall, time.process_time() - cpu
    print(f"{name:<28} {spent:8.2f} s, {used:8.2f} s of processor, peak so far {peak:5.2f} GiB")
    return found


def told(found: object, truth: dict[str, float]) -> None:
    assert isinstance(found, BrdfFit)
    for name, value in found.values.items():
        known = truth.get(name.partition("[")[0])
        if known is not None and found.table.loc[name, "status"] != "fixed":
            print(f"    {name:<6} {value:.6f}, {100 * (value / known - 1):+.4f} %")


def rendered() -> None:
    material = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.1, "material": "none"}
    taken = photograph(SphereRig.make(arc(12), radius_px=115.0, silhouette="none"), material)
    for turn in ("12 lights", "again, all compiled"):
        samples = timed(f"{turn}: extract", lambda: extract(taken.images, taken.camera, taken.lights, taken.sphere))
        assert isinstance(samples, xr.Dataset)
        found = timed(f"{turn}: fit", lambda samples=samples: fit(samples, "ggx-mirror", warn=False))
    told(found, {"ks": 1.0, "alpha": 0.1})
    for footprint in (8, None):
        name = "centres" if footprint is None else "8 x 8"
        found = timed(
            f"  footprint {name}",
            lambda f=footprint: fit(samples, "ggx-mirror", footprint=f, starts=1, warn=False),
        )
        told(found, {"ks": 1.0, "alpha": 0.1})
    plastic = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.1, "diffuse_reflectance": [0.5, 0.3, 0.1]}
    taken = photograph(
        SphereRig.make(arc(12), radius_px=115.0, silhouette="none"), plastic | {"int_ior": 1.5, "ext_ior": 1.0}
    )
    samples = extract(taken.images, taken.camera, taken.lights, taken.sphere)
    told(timed("12 lights, plastic: fit", lambda: fit(samples, "plastic", warn=False)), {"ks": 1.0, "alpha": 0.1})


def many() -> None:
    rng = np.random.default_rng(0)
    lamps = [light(float(a), float(b)) for a, b in zip(rng.uniform(5, 110, 96), rng.uniform(0, 360, 96), strict=True)]
    rig = SphereRig.make(lamps, radius_px=230.0)
    matrix = rig.camera.matrix.copy()
    matrix[:2, 2] = 305.5, 255.5
    camera = Camera(612, 512, matrix, rig.camera.rotation, rig.camera.translation)
    images = xr.DataArray(made(camera, lamps, rig.sphere, rng), dims=("light", "row", "column", "channel"))

    def read() -> Packed:
        return pack(by_light(images, camera, lamps, rig.sphere, white=65535 / 2, empty_lights="skip"))

    packed = timed("96 lights: extract, pack", read)
    assert isinstance(packed, Packed)
    print(f"    {packed.pixels.sum():.0f} pixels in {packed.size} samples, {packed.weight.size} points")
    told(timed("96 lights: fit", lambda: fit(packed, "lambert+ggx", warn=False)), TRUTH)


def made(camera: Camera, lamps: list[Light], sphere: Sphere, rng: np.random.Generator) -> np.ndarray:
    """16-bit pictures with photon noise; values at pixel centres, so that a fit over pixels is off by as much."""
    view = see(camera, sphere, max_angle=1.55, grazing_px=0.1, cut=False, max_pixels=10**7)
    images = np.zeros((len(lamps), camera.height, camera.width, 3), dtype=np.uint16)
    one = model("lambert+ggx")
    for k, lamp in enumerate(lamps):
        towards, scale = lamp.at(view.points_mm)
        cos_i = np.einsum("ni,ni->n", towards, view.normals)
        at = Cosines(cos_i.copy(), view.cos_o.copy(), np.einsum("ni,ni->n", towards, view.to_eye))
        radiance = one.at(at, TRUTH) * scale * lamp.intensity[0] * np.maximum(cos_i, 0)
        radiance += 1e-3 * rng.standard_normal(radiance.size) * np.sqrt(radiance + 0.01)
        images[k, view.rows, view.columns] = np.clip(radiance / 2 * 65535, 0, 65534)[:, None]
    return images


def losses() -> None:
    """What the loss does to a roughness where the model is not the truth, and pixels to a narrow lobe."""
    lights = arc(12)
    coat = {"type": "roughplastic", "int_ior": 1.5, "ext_ior": 1.0, "diffuse_reflectance": [0.2] * 3}
    mirror = {"type": "roughconductor", "material": "none"}
    for name, which, base, distribution, alpha in (
        ("plastic under a Beckmann coat, read as under GGX", "plastic", coat, "beckmann", 0.2),
        ("ggx read as ggx", "ggx-mirror", mirror, "ggx", 0.03),
    ):
        material = base | {"distribution": distribution, "alpha": alpha}
        taken = photograph(SphereRig.make(lights, radius_px=115.0, silhouette="none"), material)
        samples = extract(taken.images, taken.camera, taken.lights, taken.sphere)
        print(f"{name}, alpha {alpha}")
        for loss in ("cosine-weighted-l2", "log", "cube-root"):
            for footprint in ("auto", None):
                found = fit(samples, which, loss=loss, footprint=footprint, shared="all", warn=False)
                value, where = found.values["alpha"], "pixels" if footprint else "centres"
                print(f"    {loss:<20} {where:<8} alpha {value:.5f}, {100 * (value / alpha - 1):+.2f} %")


if __name__ == "__main__":
    many()
    rendered()
    losses()
