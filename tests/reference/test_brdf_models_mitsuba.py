"""The models beside the renderer's plugins of the same name. Its `eval` carries the cosine; its wi is the eye."""

import numpy as np
import pytest

from livlab.brdf.models.model import model
from livlab.machine.llvm import choose_libllvm


@pytest.fixture(scope="module")
def mi():
    choose_libllvm()
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


def directions(count, seed):
    """Pairs of directions, half of them near each other's mirror."""
    rng = np.random.default_rng(seed)
    most = np.deg2rad(85)
    cos = rng.uniform(np.cos(most), 1, (2, count))
    phi = rng.uniform(0, 2 * np.pi, (2, count))
    half = count // 2
    cos[1, :half] = np.clip(cos[0, :half] + 0.05 * rng.standard_normal(half), np.cos(most), 1)
    phi[1, :half] = phi[0, :half] + np.pi + 0.1 * rng.standard_normal(half)
    sin = np.sqrt(1 - cos**2)
    wi, wo = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1).astype(np.float32).astype(np.float64)
    # What the renderer gets is rounded to float32; renormalise what we evaluate.
    return wi / np.linalg.norm(wi, axis=-1, keepdims=True), wo / np.linalg.norm(wo, axis=-1, keepdims=True)


def rendered(mi, plugin, wi, wo):
    """f without the cosine, first channel."""
    bsdf = mi.load_dict(plugin)
    context = mi.BSDFContext()
    found = np.empty(len(wi))
    for k, (to_light, to_eye) in enumerate(zip(wi, wo, strict=True)):
        at = mi.SurfaceInteraction3f()
        at.wi = mi.Vector3f(*to_eye)
        found[k] = bsdf.eval(context, at, mi.Vector3f(*to_light))[0] / to_light[2]
    return found


def grey(value):
    return {"type": "rgb", "value": [value] * 3}


def close(ours, theirs, rtol):
    # Float32 directions move a narrow lobe by 1e-7 / alpha²: the floor leaves out what is dark beside the peak.
    np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=1e-7 * theirs.max())


def test_diffuse(mi):
    wi, wo = directions(200, 1)
    theirs = rendered(mi, {"type": "diffuse", "reflectance": grey(0.37)}, wi, wo)
    close(model("lambert").evaluate(wi, wo, {"kd": 0.37}), theirs, 1e-6)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.05, 0.1, 0.3, 0.6])
def test_rough_conductor(mi, distribution, alpha):
    wi, wo = directions(400, 2)
    plugin = {"type": "roughconductor", "distribution": distribution, "alpha": alpha}
    plugin |= {"eta": grey(0.2), "k": grey(3.9), "specular_reflectance": grey(0.8)}
    theirs = rendered(mi, plugin, wi, wo)
    ours = model(f"{distribution}-conductor").evaluate(wi, wo, {"ks": 0.8, "alpha": alpha, "eta": 0.2, "k": 3.9})
    assert np.count_nonzero(theirs > 0.01) > 50
    close(ours, theirs, 2e-5 if alpha < 0.1 else 1e-5)


def test_conductor_without_fresnel(mi):
    wi, wo = directions(300, 3)
    plugin = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.2, "material": "none"}
    close(model("ggx-mirror").evaluate(wi, wo, {"ks": 1.0, "alpha": 0.2}), rendered(mi, plugin, wi, wo), 1e-5)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.1, 0.4])
def test_rough_dielectric_from_outside(mi, distribution, alpha):
    wi, wo = directions(300, 4)
    plugin = {"type": "roughdielectric", "distribution": distribution, "alpha": alpha, "int_ior": 1.5, "ext_ior": 1.0}
    theirs = rendered(mi, plugin, wi, wo)
    close(model(distribution).evaluate(wi, wo, {"ks": 1.0, "alpha": alpha, "eta": 1.5}), theirs, 1e-5)


@pytest.mark.parametrize(
    ("distribution", "sum_", "rtol"),
    # The renderer samples visible Beckmann slopes by an approximate inverse error function; the base then differs.
    [("ggx", "plastic", 1e-5), ("beckmann", "plastic-beckmann", 2e-4)],
)
@pytest.mark.parametrize(("alpha", "eta"), [(0.05, 1.5), (0.1, 1.9), (0.3, 1.3), (0.6, 1.5)])
def test_rough_plastic(mi, distribution, sum_, rtol, alpha, eta):
    wi, wo = directions(300, 5)
    plugin = {"type": "roughplastic", "distribution": distribution, "alpha": alpha, "int_ior": eta, "ext_ior": 1.0}
    plugin |= {"diffuse_reflectance": grey(0.4), "specular_reflectance": grey(0.9)}
    theirs = rendered(mi, plugin, wi, wo)
    close(model(sum_).evaluate(wi, wo, {"kd": 0.4, "ks": 0.9, "alpha": alpha, "eta": eta}), theirs, rtol)


@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.8])
def test_principled(mi, roughness):
    wi, wo = directions(400, 6)
    plugin = {"type": "principled", "base_color": grey(0.45), "roughness": roughness, "eta": 1.5}
    theirs = rendered(mi, plugin, wi, wo)
    ours = model("principled").evaluate(wi, wo, {"kd": 0.45, "ks": 1.0, "alpha": roughness**2, "eta": 1.5})
    close(ours, theirs, 1e-5)


def test_a_wrong_lobe_would_be_seen(mi):
    """The comparison tells models apart that are near each other."""
    wi, wo = directions(300, 4)
    plugin = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.1, "int_ior": 1.5, "ext_ior": 1.0}
    theirs = rendered(mi, plugin, wi, wo)
    for name, values in (
        ("ggx", {"ks": 1.0, "alpha": 0.1001}),
        ("ggx-correlated", {"ks": 1.0, "alpha": 0.1}),
        ("beckmann", {"ks": 1.0, "alpha": 0.1}),
        ("ggx-schlick", {"F0": 0.04, "alpha": 0.1}),
    ):
        with pytest.raises(AssertionError):
            close(model(name).evaluate(wi, wo, values), theirs, 1e-5)
