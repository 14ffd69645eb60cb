"""Older models of appearance against Mitsuba's own, against quadrature and against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import plain_stack
from livlab.model.tracer.baselines.models import LobeValues, render_baseline
from livlab.model.tracer.baselines.optics import BaselineOptics, baseline_optics
from livlab.model.tracer.variant import mitsuba
from livlab.model.transport.adding_doubling import adding_doubling
from livlab.model.transport.diffusion import dipole_profile, dipole_total
from livlab.model.transport.fresnel import fresnel

WAVELENGTHS = np.array([450.0, 550.0, 650.0])
OPTICS = BaselineOptics(
    WAVELENGTHS,
    np.array([0.2, 0.3, 0.6]),
    np.array([0.5, 0.2, 0.05]),
    np.array([1.5, 1.2, 1.0]),
    np.array([1.38, 1.37, 1.36]),
    np.ones(3),
)
GREY = {"type": "spectrum", "value": 1.0}


@pytest.fixture(scope="module")
def mi() -> Any:
    return mitsuba("llvm_ad_mono")


def lights(mi: Any) -> dict[str, dict[str, Any]]:
    turn = mi.ScalarTransform4f()
    return {
        "directional": {"type": "directional", "direction": [0, 1, -1], "irradiance": GREY},
        "point": {"type": "point", "position": [30, -30, 40], "intensity": {"type": "spectrum", "value": 5000.0}},
        "constant": {"type": "constant", "radiance": GREY},
        "area": {
            "type": "rectangle",
            "to_world": turn.translate([0, 0, 40]) @ turn.rotate([1, 0, 0], 180) @ turn.scale(10),
            "emitter": {"type": "area", "radiance": {"type": "spectrum", "value": 10.0}},
        },
    }


def scene(mi: Any, body: dict[str, Any], light: dict[str, Any], size: int = 24, half: float = 12.0) -> dict[str, Any]:
    """Seen from 45° by parallel rays; `half` is half the picture's width."""
    turn = mi.ScalarTransform4f()
    return {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True},
        "sensor": {
            "type": "orthographic",
            "to_world": turn.look_at([0, -60, 60], [0, 0, 0], [0, 0, 1]) @ turn.scale([half, half, 1]),
            "film": {
                "type": "hdrfilm",
                "width": size,
                "height": size,
                "rfilter": {"type": "box"},
                "pixel_format": "luminance",
            },
        },
        "body": body,
        "lamp": light,
    }


def ball(reflectance: float = 0.3, radius: float = 10.0) -> dict[str, Any]:
    bsdf = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": reflectance}}
    return {"type": "sphere", "radius": radius, "bsdf": bsdf}


def plane(mi: Any) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(2000)}


@pytest.mark.parametrize("kind", ["directional", "point", "constant", "area"])
def test_lambert_is_mitsubas_diffuse(mi: Any, kind: str) -> None:
    world = mi.load_dict(scene(mi, ball(), lights(mi)[kind]), optimize=False)
    found = render_baseline(world, "body", "lambert", OPTICS, spp=256, seed=3)
    theirs = np.array(mi.render(world, spp=256, seed=99))[..., 0].astype(float)
    ours, error = (found[v].sel(wavelength=550).to_numpy() for v in ("radiance", "radiance_se"))
    assert theirs.mean() > 0.01
    noisy = error > 1e-6
    z = (ours - theirs)[noisy] / (np.sqrt(2) * error[noisy])
    assert np.abs(z.mean()) < 4 / np.sqrt(noisy.sum())
    assert 0.8 < z.std() < 1.2
    # At the rim all of 256 samples may miss what a few of theirs meet.
    missed = np.abs(ours - theirs)[~noisy]
    assert (missed > 1e-4 * ours.max()).sum() <= 4
    assert missed.max() < 12 / 256
    # One set of paths serves all wavelengths: they differ by their albedo alone.
    assert np.allclose(found["radiance"].sel(wavelength=650), 2 * ours, rtol=1e-12)


def test_other_objects_and_lights_in_view_are_mitsubas_too(mi: Any) -> None:
    world = scene(mi, ball(), lights(mi)["point"])
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -10]).scale(50)}
    world["floor"] = floor | {"bsdf": {"type": "roughconductor", "alpha": 0.3}}
    world["panel"] = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 5, 8]).rotate([1, 0, 0], 60).scale(3),
        "emitter": {"type": "area", "radiance": GREY},
    }
    world["integrator"]["hide_emitters"] = False
    loaded = mi.load_dict(world, optimize=False)
    found = render_baseline(loaded, "body", "lambert", OPTICS, spp=512, seed=1, hide_lights=False)
    theirs = np.array(mi.render(loaded, spp=512, seed=5))[..., 0].astype(float)
    ours, error = (found[v].sel(wavelength=550).to_numpy() for v in ("radiance", "radiance_se"))
    assert ((theirs > 0.9) & (np.abs(ours - theirs) < 1e-3)).sum() > 10  # the panel itself
    z = (ours - theirs)[error > 1e-6] / (np.sqrt(2) * error[error > 1e-6])
    assert np.abs(z.mean()) < 4 / np.sqrt(z.size)
    assert 0.8 < z.std() < 1.25


def directions(mi: Any, vectors: np.ndarray) -> Any:
    return mi.Vector3f(*(mi.Float(vectors[:, k].tolist()) for k in range(3)))


def upper(rng: np.random.Generator, count: int) -> np.ndarray:
    v = rng.normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2]) + 0.05
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


@pytest.mark.parametrize("exponent", [1.0, 20.0, 400.0])
@pytest.mark.parametrize("as_printed", [False, True])
def test_lobes_are_the_printed_formulas(mi: Any, exponent: float, as_printed: bool) -> None:
    rng = np.random.default_rng(4)
    wi, wo = upper(rng, 500), upper(rng, 500)
    h = wi + wo
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    nh, vh = h[:, 2], (wo * h).sum(axis=1)
    blinn = [np.array(x) for x in LobeValues(mi, "blinn-phong", exponent, as_printed).lobes(*_both(mi, wi, wo))]
    m = exponent
    scale = (m + 2) * (m + 4) / (8 * np.pi * (2 ** (-m / 2) + m))
    expected = nh**m / np.pi if as_printed else scale * nh**m * wi[:, 2]
    assert np.allclose(blinn[0], wi[:, 2] / np.pi, rtol=1e-5)
    assert np.allclose(blinn[1], expected, rtol=1e-4, atol=1e-7)
    lobes = [np.array(x) for x in LobeValues(mi, "ashikhmin-shirley", m, as_printed).lobes(*_both(mi, wi, wo))]
    f0 = 0.04
    printed = (m + 1) / (8 * np.pi) * nh**m / (vh * np.maximum(wi[:, 2], wo[:, 2])) * (f0 + (1 - f0) * (1 - vh) ** 5)
    assert np.allclose(f0 * lobes[1] + (1 - f0) * lobes[2], printed * wi[:, 2], rtol=1e-4, atol=1e-7)


def _both(mi: Any, wi: np.ndarray, wo: np.ndarray) -> tuple[Any, Any]:
    return directions(mi, wi), directions(mi, wo)


@pytest.mark.parametrize("name", ["lambert", "blinn-phong", "ashikhmin-shirley"])
def test_lobes_are_reciprocal_and_reflect_no_more_than_there_is(mi: Any, name: str) -> None:
    rng = np.random.default_rng(5)
    wi, wo = upper(rng, 400), upper(rng, 400)
    lobes = LobeValues(mi, name, 30.0, False)
    for one, other in zip(lobes.lobes(*_both(mi, wi, wo)), lobes.lobes(*_both(mi, wo, wi)), strict=True):
        assert np.allclose(np.array(one) / wi[:, 2], np.array(other) / wo[:, 2], rtol=1e-4, atol=1e-6)
    mu, weight = np.polynomial.legendre.leggauss(160)
    mu, weight = (mu + 1) / 2, weight / 2
    phi = (np.arange(240) + 0.5) * 2 * np.pi / 240
    sine = np.sqrt(1 - mu**2)
    grid = np.stack([np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi)), np.outer(mu, np.ones(240))], -1)
    for cosine in (1.0, 0.7, 0.3, 0.1):
        eye = np.tile([np.sqrt(1 - cosine**2), 0.0, cosine], (grid[..., 0].size, 1))
        terms = lobes.lobes(*_both(mi, grid.reshape(-1, 3), eye))
        albedo = [float((np.array(t).reshape(160, 240).mean(axis=1) * 2 * np.pi * weight).sum()) for t in terms]
        assert albedo[0] == pytest.approx(1.0, abs=1e-4)
        if name == "blinn-phong":
            assert albedo[1] <= 1.0 + 1e-4
            if cosine == 1.0:
                assert albedo[1] == pytest.approx(1.0, abs=1e-4)
        if name == "ashikhmin-shirley":  # a surface that reflects all: F₀ = 1
            assert 0.1 < albedo[1] <= 1.0 + 1e-4


def test_blinn_phong_as_printed_is_not_reciprocal(mi: Any) -> None:
    rng = np.random.default_rng(5)
    wi, wo = upper(rng, 50), upper(rng, 50)
    lobes = LobeValues(mi, "blinn-phong", 5.0, True)
    there, back = (np.array(lobes.lobes(*_both(mi, a, b))[1]) / a[:, 2] for a, b in ((wi, wo), (wo, wi)))
    assert np.abs(there / back - 1).max() > 0.5


def test_gloss_adds_to_the_picture_as_it_should(mi: Any) -> None:
    """A plane under parallel light at 45°, seen from the mirror direction: the radiance is the formula."""
    world = scene(mi, plane(mi), lights(mi)["directional"], 4, 1.0)
    cosine = np.sqrt(0.5)
    f0 = OPTICS.normal_reflectance
    lambert = OPTICS.reflectance / np.pi * cosine
    m = 60.0
    scale = (m + 2) * (m + 4) / (8 * np.pi * (2 ** (-m / 2) + m))
    fresnel_term = f0 + (1 - f0) * (1 - cosine) ** 5
    lobe = (m + 1) / (8 * np.pi) / (cosine * cosine) * fresnel_term * cosine
    # Light falls along (0, 1, −1) and the eye looks along (0, 1, −1) too: light and eye coincide, h is 45° off.
    h = cosine**m
    for name, printed, expected in (
        ("blinn-phong", False, lambert + f0 * scale * h * cosine),
        ("blinn-phong", True, lambert + f0 * h / np.pi),
        ("ashikhmin-shirley", False, lambert + (m + 1) / (8 * np.pi) * h * f0),
        ("ashikhmin-shirley", True, lambert + OPTICS.reflectance * (m + 1) / (8 * np.pi) * h * f0),
    ):
        found = render_baseline(world, "body", name, OPTICS, spp=4, as_printed=printed)
        assert np.allclose(found["radiance"], expected, rtol=1e-4)
    mirrored = dict(world, lamp={"type": "directional", "direction": [0, -1, -1], "irradiance": GREY})
    found = render_baseline(mirrored, "body", "ashikhmin-shirley", OPTICS, spp=4)
    assert np.allclose(found["radiance"], lambert + lobe, rtol=1e-3)


def test_dipole_on_a_flat_plate_is_its_closed_form(mi: Any) -> None:
    world = scene(mi, plane(mi), lights(mi)["directional"], 4, 1.0)
    found = render_baseline(world, "body", "dipole", OPTICS, spp=1 << 15, seed=2)
    cosine = np.sqrt(0.5)
    expected = np.array(
        [
            dipole_total(a, s, n) * (1 - fresnel(1.0, n, cosine)) ** 2 * cosine / np.pi
            for a, s, n in zip(OPTICS.absorption, OPTICS.reduced_scattering, OPTICS.n, strict=True)
        ]
    )
    mean = found["radiance"].mean(("row", "column")).to_numpy()
    error = np.sqrt((found["radiance_se"] ** 2).sum(("row", "column")).to_numpy()) / 16
    assert np.all(error < 0.003 * expected)
    assert np.all(np.abs(mean - expected) < 4 * error)


def test_dipole_bends_around_a_small_sphere_as_quadrature_says(mi: Any) -> None:
    """Light from the side reaches the dark half; a point there is the area integral over the lit half."""
    radius = 4.0
    eye = np.array([0.0, -1.0, 1.0]) / np.sqrt(2)
    world = scene(
        mi, ball(radius=radius), {"type": "directional", "direction": [0, -1, 0.2], "irradiance": GREY}, 1, 0.02
    )
    found = render_baseline(world, "body", "dipole", OPTICS, spp=1 << 17, seed=7)
    mu, weight = np.polynomial.legendre.leggauss(600)
    mu, weight = (mu + 1) / 2, weight / 2
    phi = (np.arange(1200) + 0.5) * 2 * np.pi / 1200
    to_light = np.array([0.0, 1.0, -0.2]) / np.hypot(1.0, 0.2)
    across = np.array([1.0, 0.0, 0.0])
    third = np.cross(to_light, across)
    sine = np.sqrt(1 - mu**2)
    points = radius * (
        mu[:, None, None] * to_light
        + (sine[:, None] * np.cos(phi))[..., None] * across
        + (sine[:, None] * np.sin(phi))[..., None] * third
    )
    distance = np.linalg.norm(points - radius * eye, axis=-1)
    for k in range(3):
        a, s, n = OPTICS.absorption[k], OPTICS.reduced_scattering[k], OPTICS.n[k]
        entering = mu * (1 - fresnel(1.0, n, mu))
        inner = dipole_profile(distance, a, s, n).mean(axis=1) * 2 * np.pi * radius**2
        expected = (1 - fresnel(1.0, n, 1.0)) / np.pi * float((inner * entering * weight).sum())
        value, error = (float(found[v][0, 0, k]) for v in ("radiance", "radiance_se"))
        assert error < 0.05 * expected
        assert abs(value - expected) < 4 * error + 2e-3 * expected  # the pixel is 0.04 mm wide


def test_the_scenes_unit_changes_nothing(mi: Any) -> None:
    big = scene(mi, ball(), lights(mi)["directional"], 6)
    small = scene(mi, ball(radius=1.0), lights(mi)["directional"], 6, 1.2)
    one = render_baseline(big, "body", "dipole", OPTICS, spp=512, seed=1)
    other = render_baseline(small, "body", "dipole", OPTICS, spp=512, seed=2, mm_per_unit=10.0)
    z = (one["radiance"] - other["radiance"]) / np.hypot(one["radiance_se"], other["radiance_se"]).where(
        lambda x: x > 0
    )
    assert np.abs(z.mean()) < 0.5
    assert np.abs(z).max() < 5


def test_stated_errors_are_the_scatter_over_seeds(mi: Any) -> None:
    world = mi.load_dict(scene(mi, ball(), lights(mi)["area"], 6), optimize=False)
    for name in ("blinn-phong", "dipole"):
        runs = [render_baseline(world, "body", name, OPTICS, spp=64, seed=s) for s in range(24)]
        values = np.array([r["radiance"].to_numpy() for r in runs])
        stated = np.sqrt(np.mean([r["radiance_se"].to_numpy() ** 2 for r in runs], axis=0))
        lit = stated > 1e-3 * values.mean()
        ratio = values.std(axis=0, ddof=1)[lit] / stated[lit]
        assert lit.sum() > 30
        assert 0.85 < np.sqrt((ratio**2).mean()) < 1.15


def test_many_passes_are_one_picture(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from livlab.model.tracer.baselines import pixels

    world = mi.load_dict(scene(mi, ball(), lights(mi)["area"], 12), optimize=False)
    whole = render_baseline(world, "body", "lambert", OPTICS, spp=64, seed=1)
    told: list[float] = []
    monkeypatch.setattr(pixels, "PASS_SAMPLES", 100)
    parts = render_baseline(world, "body", "lambert", OPTICS, spp=16, seed=2, on_pass=told.append)
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)
    assert len(told) > 16
    difference = float((whole["radiance"] - parts["radiance"]).mean())
    error = float(np.sqrt((whole["radiance_se"] ** 2 + parts["radiance_se"] ** 2).sum())) / whole["radiance"].size
    assert abs(difference) < 4 * np.sqrt(3) * error  # the wavelengths share their samples


def test_numbers_of_a_tissue() -> None:
    stack = plain_stack(
        [(1.36, 0.01, 20.0, 0.1, HenyeyGreenstein(0.9)), (1.38, 0.2, 10.0, np.inf, HenyeyGreenstein(0.8))]
    )
    optics = baseline_optics(stack)
    assert optics.reflectance == pytest.approx(adding_doubling(stack)["reflectance"].to_numpy(), abs=1e-4)
    assert optics.absorption == pytest.approx([0.2])
    assert optics.reduced_scattering == pytest.approx([2.0])
    assert optics.normal_reflectance == pytest.approx([(0.38 / 2.38) ** 2])


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"name": "phong"}, "baseline"),
        ({"surfaces": "liver"}, "surfaces"),
        ({"spp": 1}, "spp"),
        ({"exponent": float("nan")}, "exponent"),
        ({"mm_per_unit": 0.0}, "mm_per_unit"),
        ({"variant": "llvm_ad_rgb"}, "variant"),
    ],
)
def test_bad_input_is_refused_by_name(mi: Any, change: dict[str, Any], field: str) -> None:
    call = {"surfaces": "body", "name": "lambert", "optics": OPTICS} | change
    world = scene(mi, ball(), lights(mi)["point"], 2)
    try:
        with pytest.raises(InputError, match=field):
            render_baseline(world, **call)
    finally:
        mi.set_variant("llvm_ad_mono")
    with pytest.raises(InputError, match="reflectance"):
        BaselineOptics(WAVELENGTHS, np.array([1.2]), np.ones(3), np.ones(3), np.ones(3), np.ones(3))
