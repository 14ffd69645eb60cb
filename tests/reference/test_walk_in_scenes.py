"""The walk in a scene against plane layers, against Mitsuba's own volume tracer, and against itself in other units.

Each value is held within four standard errors that are small against it (the bound on their ratio is stated), so that
a bias of a few of them fails.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import OpticalStack, plain_stack
from livlab.model.tracer.body import Body
from livlab.model.tracer.render import render
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.adding_doubling import adding_doubling

HALF, HIGH = 40.0, 20.0
# Cases ii and iii of Prahl, van Gemert & Welch's kind, in 1/mm: a half-space, and a thin layer over a thick one.
HALFSPACE = plain_stack([(1.5, 1.0, 9.0, 1e3, Isotropic())])
LAYERS = plain_stack([(1.36, 0.01, 10.0, 0.1, HenyeyGreenstein(0.9)), (1.38, 0.5, 15.0, 50.0, HenyeyGreenstein(0.9))])


@dataclass
class Grid:
    """A distance field from a closed form."""

    origin_mm: Any
    spacing_mm: float
    values: Any


def grid(distance: Any, reach: Any, step: float) -> Grid:
    low = -np.asarray(reach, dtype=float) - 2 * step
    n = np.ceil(-2 * low / step).astype(int) + 1
    z, y, x = np.meshgrid(*[low[a] + step * np.arange(n[a]) for a in (2, 1, 0)], indexing="ij")
    return Grid(low, step, distance(x, y, z).astype(np.float32))


def box_distance(x: Any, y: Any, z: Any) -> Any:
    q = np.stack([np.abs(x) - HALF, np.abs(y) - HALF, np.abs(z) - HIGH / 2])
    return -(np.linalg.norm(np.maximum(q, 0), axis=0) + np.minimum(q.max(0), 0))


@pytest.fixture(scope="module")
def box_field() -> Grid:
    return grid(box_distance, (HALF, HALF, HIGH / 2), 0.5)


def camera(origin: Any, target: Any, width: float, pixels: int = 4) -> dict[str, Any]:
    t = mitsuba("llvm_ad_spectral").ScalarTransform4f
    film = {"type": "hdrfilm", "width": pixels, "height": pixels, "rfilter": {"type": "box"}}
    view = t().look_at(origin=list(origin), target=list(target), up=[0, 1, 0]) @ t().scale([width, width, 1])
    return {"type": "orthographic", "near_clip": 1e-4 * width, "far_clip": 1e5 * width, "to_world": view, "film": film}


def slab(unit: float = 1.0, angle_deg: float = 0.0) -> dict[str, Any]:
    """A wide block under a camera that looks at the middle of its top; lengths in units of `unit` mm."""
    t = mitsuba("llvm_ad_spectral").ScalarTransform4f
    a = np.radians(angle_deg)
    top = np.array([0, 0, HIGH / 2])
    eye = top + 500.0 * np.array([np.sin(a), 0, np.cos(a)])
    size = t().scale([HALF / unit, HALF / unit, HIGH / 2 / unit])
    return {
        "type": "scene",
        "slab": {"type": "cube", "to_world": size, "bsdf": {"type": "diffuse"}},
        "sensor": camera(eye / unit, top / unit, 1.0 / unit),
    }


def lit(scene: dict[str, Any], angle_deg: float | None = None) -> dict[str, Any]:
    """Under the same light from everywhere, or under a beam of irradiance 1 across it."""
    one = {"type": "spectrum", "value": 1.0}
    if angle_deg is None:
        return {**scene, "light": {"type": "constant", "radiance": one}}
    a = np.radians(angle_deg)
    beam = [-float(np.sin(a)), 0.0, -float(np.cos(a))]
    return {**scene, "light": {"type": "directional", "direction": beam, "irradiance": one}}


def mean(found: Any) -> tuple[Any, Any]:
    """Mean over the pixels and its standard error, by wavelength."""
    n = found.sizes["row"] * found.sizes["column"]
    error = np.sqrt((found["radiance_se"] ** 2).sum(("row", "column")).to_numpy()) / n
    return found["radiance"].mean(("row", "column")).to_numpy(), error


def agree(found: Any, wanted: Any, power: float) -> None:
    """Within four standard errors, themselves at most `power` of the value."""
    value, error = mean(found)
    wanted = np.asarray(wanted)
    assert np.all(error <= power * wanted), error / wanted
    assert np.all(np.abs(value - wanted) <= 4 * error + 1e-5 * wanted), (value - wanted) / error


@pytest.mark.parametrize("stack", [HALFSPACE, LAYERS], ids=["half-space", "layers"])
def test_a_wide_block_under_even_light_is_the_total_reflectance(stack: OpticalStack, box_field: Grid) -> None:
    # By reciprocity: radiance to the normal under light 1 from everywhere = all that a beam on the normal gives back.
    found = render(lit(slab()), [500.0], body=Body(stack, "slab", box_field), spp=6000, seed=3)
    solved = adding_doubling(stack)
    agree(found, (solved["reflectance"] + solved["specular"]).to_numpy(), power=0.012)


@pytest.mark.parametrize(("light", "eye"), [(45.0, 0.0), (0.0, 60.0)])
def test_a_beam_is_seen_as_adding_doubling_has_it(light: float, eye: float) -> None:
    from livlab.model.transport.adding_doubling import exit_flux

    found = render(lit(slab(angle_deg=eye), light), [500.0], body=Body(HALFSPACE, "slab"), spp=6000, seed=5)
    incident, out = np.cos(np.radians(light)), np.cos(np.radians(eye))
    flux = exit_flux(adding_doubling(HALFSPACE, mu0=float(incident)), float(out)).to_numpy().ravel()[0]
    agree(found, [flux / out * incident], power=0.012)


@pytest.mark.parametrize("unit", [0.1, 10.0, 1000.0])
def test_units_of_the_scene_change_nothing(unit: float, box_field: Grid) -> None:
    found = render(lit(slab(unit)), [500.0], body=Body(LAYERS, "slab", box_field, mm_per_unit=unit), spp=6000, seed=3)
    solved = adding_doubling(LAYERS)
    agree(found, (solved["reflectance"] + solved["specular"]).to_numpy(), power=0.012)


def ball(radius: float, eye: float = 50.0, **more: Any) -> dict[str, Any]:
    return {
        "type": "scene",
        "ball": {"type": "sphere", "radius": radius, "bsdf": {"type": "diffuse"}},
        "sensor": camera((0, 0, eye), (0, 0, 0), 0.7 * radius),
        **more,
    }


def test_white_tissue_in_even_light_cannot_be_told_from_it() -> None:
    white = plain_stack([(1.0, 0.0, 2.0, 1e3, HenyeyGreenstein(0.7))])
    found = render(lit(ball(5.0)), [500.0], body=Body(white, "ball"), spp=400, seed=2)
    # No light is made or lost: every path ends in the light of 1, so that there is no noise either.
    np.testing.assert_allclose(found["radiance"].to_numpy(), 1.0, atol=2e-4)


def test_nor_behind_a_surface_that_reflects() -> None:
    # Which of two ways a path takes is drawn with other chances than theirs, so that only the mean is 1.
    white = plain_stack([(1.4, 0.0, 2.0, 1e3, HenyeyGreenstein(0.7))])
    agree(render(lit(ball(5.0)), [500.0], body=Body(white, "ball"), spp=12000, seed=2), [1.0], power=0.0015)


def test_a_ball_is_mitsubas_own() -> None:
    mi = mitsuba("llvm_ad_spectral")
    sigma_s, sigma_a, index = 0.4, 0.05, 1.4
    inside = {
        "type": "homogeneous",
        "albedo": {"type": "spectrum", "value": sigma_s / (sigma_s + sigma_a)},
        "sigma_t": {"type": "spectrum", "value": sigma_s + sigma_a},
        "phase": {"type": "hg", "g": 0.5},
    }
    glass = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
    scene = lit(ball(5.0))
    integrator = {"type": "volpath", "max_depth": 1000, "rr_depth": 1000}
    theirs = {
        **scene,
        "ball": {"type": "sphere", "radius": 5.0, "bsdf": glass, "interior": inside},
        "integrator": integrator,
    }
    nothing = {k: v for k, v in scene.items() if k != "ball"} | {"integrator": integrator}

    def pictures(of: dict[str, Any], count: int) -> Any:
        loaded = mi.load_dict(of, optimize=False)
        return np.array([np.array(mi.render(loaded, spp=512, seed=k)).mean() for k in range(count)])

    # The film's colours of a grey spectrum do not average to it, and their mean is noisy over the wavelengths too.
    light = pictures(nothing, 32)
    balls = pictures(theirs, 32)
    wanted = float(balls.mean() / light.mean())
    spread = wanted * np.hypot(*(float(x.std(ddof=1) / np.sqrt(len(x)) / x.mean()) for x in (balls, light)))
    stack = plain_stack([(index, sigma_a, sigma_s, 1e3, HenyeyGreenstein(0.5))])
    value, error = mean(render(scene, [500.0], body=Body(stack, "ball"), spp=12000, seed=9))
    both = float(np.hypot(error[0], spread))
    assert both < 0.004 * wanted
    assert abs(value[0] - wanted) < 4 * both, (value[0] - wanted) / both


def test_layers_by_depth_are_those_between_nested_surfaces() -> None:
    radius = 10.0
    field = grid(lambda x, y, z: radius - np.sqrt(x * x + y * y + z * z), (radius,) * 3, 0.25)
    scene = lit(ball(radius))
    nested = {**scene, "core": {"type": "sphere", "radius": radius - 0.1, "bsdf": {"type": "diffuse"}}}
    by_depth = mean(render(scene, [500.0], body=Body(LAYERS, "ball", field), spp=6000, seed=4))
    by_shape = mean(render(nested, [500.0], body=Body(LAYERS, ("ball", "core")), spp=6000, seed=5))
    error = np.hypot(by_depth[1], by_shape[1])
    assert np.all(error < 0.012 * by_shape[0])
    assert np.all(np.abs(by_depth[0] - by_shape[0]) < 4 * error), (by_depth[0] - by_shape[0]) / error


def spectrum(wavelengths: Any) -> OpticalStack:
    """Scattering and absorption that change a lot over four wavelengths."""
    k = (np.asarray(wavelengths) - 500.0) / 100.0
    parts = [plain_stack([(1.4, 0.2 * 4.0**a, 4.0 * 1.3**-a, 1e3, HenyeyGreenstein(0.8))]) for a in k]
    from dataclasses import replace

    first = parts[0].layers[0]
    interactions = tuple(
        replace(
            i,
            rate=np.array([p.layers[0].interactions[j].rate[0] for p in parts]),
            albedo=np.array([p.layers[0].interactions[j].albedo[0] for p in parts]),
            phases=tuple(p.layers[0].interactions[j].phases[0] for p in parts),
        )
        for j, i in enumerate(first.interactions)
    )
    n = np.full(len(parts), 1.4)
    one = np.ones(len(parts))
    layer = replace(first, n=n, interactions=interactions)
    return OpticalStack(np.asarray(wavelengths, dtype=float), (layer,), one, one, "spectrum", ())


def test_one_path_serves_all_wavelengths() -> None:
    wavelengths = [500.0, 550.0, 600.0, 700.0]
    stack = spectrum(wavelengths)
    solved = adding_doubling(stack)
    wanted = (solved["reflectance"] + solved["specular"]).to_numpy()
    together = render(lit(slab()), wavelengths, body=Body(stack, "slab"), spp=6000, seed=6)
    agree(together, wanted, power=0.02)


def test_a_pixel_of_many_samples_keeps_its_mean() -> None:
    scene = lit(ball(5.0))
    scene["sensor"] = camera((0, 0, 50), (0, 0, 0), 3.0, pixels=1)
    stack = plain_stack([(1.4, 0.5, 2.0, 1e3, Isotropic())])
    value, error = mean(render(scene, [500.0], body=Body(stack, "ball"), spp=200_000, seed=1))
    parts = np.array(
        [mean(render(scene, [500.0], body=Body(stack, "ball"), spp=25_000, seed=k))[0][0] for k in range(2, 10)]
    )
    spread = parts.std(ddof=1) / np.sqrt(len(parts))
    assert error[0] < 0.004 * value[0]
    assert abs(value[0] - parts.mean()) < 4 * np.hypot(error[0], spread)


def test_seeds() -> None:
    scene, stack = lit(ball(5.0)), plain_stack([(1.4, 0.5, 2.0, 1e3, Isotropic())])
    first, again, other = (
        render(scene, [500.0], body=Body(stack, "ball"), spp=64, seed=s)["radiance"].to_numpy() for s in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_stated_errors_are_those_between_seeds() -> None:
    scene, stack = lit(ball(5.0)), plain_stack([(1.4, 0.5, 2.0, 1e3, Isotropic())])
    runs = [render(scene, [500.0], body=Body(stack, "ball"), spp=256, seed=s) for s in range(12)]
    values = np.array([r["radiance"].to_numpy()[..., 0] for r in runs])
    stated = np.sqrt(np.mean([r["radiance_se"].to_numpy()[..., 0] ** 2 for r in runs], axis=0))
    ratio = float(np.sqrt(np.mean(values.var(axis=0, ddof=1) / stated**2)))
    assert 0.8 < ratio < 1.25  # 16 pixels × 11 degrees of freedom: ±5 %


def test_an_eye_within_the_tissue_sees_it() -> None:
    # Deep in white tissue under even light all is 1; an eye inside must not be taken for one outside.
    white = plain_stack([(1.0, 0.0, 2.0, 1e3, Isotropic())])
    found = render(lit(ball(5.0, eye=1.0)), [500.0], body=Body(white, "ball"), spp=64, seed=2)
    np.testing.assert_allclose(found["radiance"].to_numpy(), 1.0, atol=2e-4)


def test_thin_layers_on_a_large_body_do_not_leak() -> None:
    # A black layer of 0.1 mm on a ball of 140 mm: whatever light gets through it must not come back.
    black = plain_stack([(1.0, 200.0, 0.0, 0.1, Isotropic()), (1.0, 0.0, 5.0, 1e3, Isotropic())])
    radius = 70.0
    field = grid(lambda x, y, z: radius - np.sqrt(x * x + y * y + z * z), (radius,) * 3, 1.0)
    found = render(lit(ball(radius, eye=500.0)), [500.0], body=Body(black, "ball", field), spp=400, seed=2)
    assert float(found["radiance"].max()) < 1e-6
