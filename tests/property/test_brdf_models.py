import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from livlab.brdf.models.energy import directional_albedo
from livlab.brdf.models.model import LOBES, SUMS, model, models
from livlab.errors import InputError

ALL = [*LOBES, *SUMS, "lambert+ggx+ggx"]
ANGLES = np.deg2rad([0.0, 20.0, 45.0, 70.0, 85.0])
# Lobes that a published derivation keeps from giving back more than they get; scale 1, all parameters at their starts.
CONSERVING = [
    "lambert",
    "oren-nayar-qualitative",
    "ashikhmin-shirley-coupled",
    "plastic",
    "plastic-beckmann",
    "ggx",
    "ggx-mirror",
    "ggx-conductor",
    "ggx-schlick",
    "ggx-correlated",
    "beckmann",
    "beckmann-mirror",
]


def pairs(count, seed):
    rng = np.random.default_rng(seed)
    v = rng.standard_normal((2, count, 3))
    v[..., 2] = np.abs(v[..., 2]) + 0.05
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("name", ALL)
def test_reciprocal_where_it_says_so(name):
    wi, wo = pairs(500, 1)
    one = model(name)
    there, back = one.evaluate(wi, wo, {}), one.evaluate(wo, wi, {})
    same = np.allclose(there, back, rtol=1e-12, atol=0)
    assert same == one.reciprocal
    assert one.reciprocal == ("classic" not in name)
    assert np.all(there >= 0)
    assert there.max() > 0


@pytest.mark.parametrize("name", ALL)
def test_isotropic_mirrored_and_dark_below(name):
    wi, wo = pairs(300, 2)
    one = model(name)
    plain = one.evaluate(wi, wo, {})
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(one.evaluate(wi @ turn.T, wo @ turn.T, {}), plain, rtol=1e-9)
    flip = np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(one.evaluate(wi * flip, wo * flip, {}), plain, rtol=1e-12)
    down = np.array([1.0, 1.0, -1.0])
    assert np.all(one.evaluate(wi * down, wo, {}) == 0)
    assert np.all(one.evaluate(wi, wo * down, {}) == 0)
    assert np.all(one.evaluate(wi * down, wo * down, {}) == 0)
    assert np.all(np.isfinite(one.evaluate([0.0, 0, 1], [0.0, 0, 1], {})))
    assert one.evaluate([1.0, 0, 0], [0.0, 0, 1], {}) == 0
    assert np.isfinite(one.evaluate([1.0, 0, 0], [-1.0, 0, 0], {}))


@pytest.mark.parametrize("name", CONSERVING)
def test_no_more_light_comes_back_than_went_in(name):
    one = model(name)
    values = {p.name: 1.0 for p in one.parameters if p.name in ("kd", "ks")}
    for alpha in (0.05, 0.3, 1.0):
        extra = {"alpha": alpha} if any(p.name == "alpha" for p in one.parameters) else {}
        albedo = directional_albedo(one, values | extra, ANGLES)
        assert float(albedo.max()) <= 1 + 1e-4
        assert float(albedo.min()) > 0


def test_those_that_do_not_conserve_energy_are_seen_to():
    assert float(directional_albedo("blinn-phong-classic", {"ks": 1.0, "exponent": 5.0}, [1.45]).max()) > 1
    assert float(directional_albedo("blinn-phong", {"ks": 1.0, "exponent": 100.0}, ANGLES).max()) > 1
    # Oren & Nayar's fit to their own integrals, as printed, gives a white surface back a little too much light.
    white = directional_albedo("oren-nayar", {"kd": 1.0, "sigma": 0.3}, ANGLES)
    assert 1.02 < float(white.max()) < 1.04
    assert float(white[:4].max()) < 1


@pytest.mark.parametrize("alpha", [0.01, 0.03, 0.1, 0.4])
def test_a_mirror_of_ggx_gives_back_all_but_what_it_shadows(alpha):
    # At normal incidence and small roughness nothing is shadowed; the quadrature must hold for narrow lobes.
    found = float(directional_albedo("ggx-mirror", {"ks": 1.0, "alpha": alpha}, [0.0])[0])
    finer = float(directional_albedo("ggx-mirror", {"ks": 1.0, "alpha": alpha}, [0.0], order=200)[0])
    assert found == pytest.approx(finer, abs=1e-6)
    assert 1 - 1.5 * alpha**2 * max(1.0, math.log(1 / alpha)) < found <= 1


def test_the_albedo_is_the_published_one():
    assert np.allclose(directional_albedo("lambert", {"kd": 0.37}, ANGLES), 0.37, atol=1e-9)
    for m in (1.0, 20.0, 500.0):
        found = directional_albedo("blinn-phong", {"ks": 1.0, "exponent": m}, [0.0])
        assert float(found[0]) == pytest.approx(1.0, abs=1e-6)
    wi = np.array([0.0, 0.0, 1.0])
    cos = np.cos(0.3)
    wo = np.array([math.sin(0.3), 0.0, cos])
    f = model("oren-nayar").evaluate(wi, wo, {"kd": 0.6, "sigma": 0.0})
    assert float(f) == pytest.approx(0.6 / math.pi, rel=1e-12)


def literal_oren_nayar(ti, to, dphi, rho, sigma):
    """Oren & Nayar 1994, eq. 25 to 27, written out as printed."""
    alpha, beta, s2 = max(ti, to), min(ti, to), sigma**2
    c1 = 1 - 0.5 * s2 / (s2 + 0.33)
    inner = math.sin(alpha) - (0 if math.cos(dphi) >= 0 else (2 * beta / math.pi) ** 3)
    c2 = 0.45 * s2 / (s2 + 0.09) * inner
    c3 = 0.125 * s2 / (s2 + 0.09) * (4 * alpha * beta / math.pi**2) ** 2
    one = c1 + math.cos(dphi) * c2 * math.tan(beta)
    one += (1 - abs(math.cos(dphi))) * c3 * math.tan((alpha + beta) / 2)
    two = 0.17 * rho**2 / math.pi * s2 / (s2 + 0.13) * (1 - math.cos(dphi) * (2 * beta / math.pi) ** 2)
    return rho / math.pi * one + two


@settings(max_examples=60, deadline=None)
@given(st.floats(0.02, 1.4), st.floats(0.02, 1.4), st.floats(0, math.pi), st.floats(0.05, 1.0), st.floats(0.0, 1.0))
def test_oren_nayar_is_the_printed_one(ti, to, dphi, rho, sigma):
    wi = [math.sin(ti), 0.0, math.cos(ti)]
    wo = [math.sin(to) * math.cos(dphi), math.sin(to) * math.sin(dphi), math.cos(to)]
    found = float(model("oren-nayar").evaluate(wi, wo, {"kd": rho, "sigma": sigma}))
    assert found == pytest.approx(literal_oren_nayar(ti, to, dphi, rho, sigma), rel=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 1.4), st.floats(0, 1.4), st.floats(0, math.pi), st.floats(1, 300), st.floats(0.01, 0.9))
def test_ashikhmin_shirley_is_the_printed_one(ti, to, dphi, n, rs):
    wi = np.array([math.sin(ti), 0.0, math.cos(ti)])
    wo = np.array([math.sin(to) * math.cos(dphi), math.sin(to) * math.sin(dphi), math.cos(to)])
    h = (wi + wo) / np.linalg.norm(wi + wo)
    fresnel = rs + (1 - rs) * (1 - h @ wi) ** 5
    lobe = (n + 1) / (8 * math.pi) * h[2] ** n / ((h @ wi) * max(wi[2], wo[2])) * fresnel
    base = 28 * 0.4 / (23 * math.pi) * (1 - rs) * (1 - (1 - wi[2] / 2) ** 5) * (1 - (1 - wo[2] / 2) ** 5)
    values = {"kd": 0.4, "Rs": rs, "exponent": n}
    coupled = float(model("ashikhmin-shirley-coupled").evaluate(wi, wo, values))
    assert coupled == pytest.approx(base + lobe, rel=1e-9)
    plain = float(model("nunes-2017").evaluate(wi, wo, values))
    assert plain == pytest.approx(0.4 / math.pi + lobe, rel=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 1.4), st.floats(0, 1.4), st.floats(0, math.pi), st.floats(1, 60), st.floats(0.5, 2))
def test_lafortune_is_a_power_of_a_scaled_dot_product(ti, to, dphi, n, ratio):
    wi = np.array([math.sin(ti), 0.0, math.cos(ti)])
    wo = np.array([math.sin(to) * math.cos(dphi), math.sin(to) * math.sin(dphi), math.cos(to)])
    c_xy = -2 / (1 + ratio)
    dot = c_xy * (wi[0] * wo[0] + wi[1] * wo[1]) - ratio * c_xy * wi[2] * wo[2]
    expected = (n + 2) / (2 * math.pi) * max(dot, 0) ** n
    found = float(model("lafortune").evaluate(wi, wo, {"ks": 1.0, "exponent": n, "ratio": ratio}))
    assert found == pytest.approx(expected, rel=1e-8, abs=1e-300)


def test_schlick_nears_the_exact_term_and_the_conductor_the_dielectric():
    wi, wo = pairs(300, 5)
    exact = model("ggx").evaluate(wi, wo, {"ks": 1.0, "alpha": 0.3, "eta": 1.5})
    schlick = model("ggx-schlick").evaluate(wi, wo, {"F0": 0.04, "alpha": 0.3})
    assert np.max(np.abs(schlick / exact - 1)) < 0.25
    assert np.max(np.abs(schlick / exact - 1)) > 1e-3
    metal = model("ggx-conductor").evaluate(wi, wo, {"ks": 1.0, "alpha": 0.3, "eta": 1.5, "k": 0.02})
    np.testing.assert_allclose(metal, exact, rtol=5e-3)


def test_channels_broadcast_and_sums_add_up():
    wi, wo = pairs(20, 3)
    colour = model("lambert+ggx").evaluate(wi, wo, {"kd": [0.1, 0.2, 0.3], "ks": 0.4, "alpha": 0.2})
    assert colour.shape == (20, 3)
    single = model("lambert").evaluate(wi, wo, {"kd": 0.2}) + model("ggx").evaluate(wi, wo, {"ks": 0.4, "alpha": 0.2})
    np.testing.assert_allclose(colour[:, 1], single, rtol=1e-12)
    twice = model("ggx+ggx").evaluate(wi, wo, {"ks": 0.3, "ks2": 0.3, "alpha": 0.2, "alpha2": 0.2})
    np.testing.assert_allclose(twice, model("ggx").evaluate(wi, wo, {"ks": 0.6, "alpha": 0.2}), rtol=1e-12)
    grid = model("ggx").evaluate(wi[:, None], wo[None], {})
    assert grid.shape == (20, 20)
    names = [p.name for p in model("lambert+ggx+beckmann").parameters]
    assert names == ["kd", "ks", "alpha", "eta", "ks2", "alpha2", "eta2"]


def test_wrong_models_and_values_are_refused():
    up = [0.0, 0.0, 1.0]
    with pytest.raises(InputError, match="is no lobe"):
        model("phung")
    with pytest.raises(InputError, match="has no such"):
        model("lambert").evaluate(up, up, {"ks": 1})
    with pytest.raises(InputError, match="must lie within"):
        model("ggx").evaluate(up, up, {"alpha": 2.0})
    with pytest.raises(InputError, match="must lie within"):
        model("ggx").evaluate(up, up, {"alpha": math.nan})
    with pytest.raises(InputError, match="do not agree"):
        model("lambert+ggx").evaluate(up, up, {"kd": [0.1, 0.2], "ks": [0.1, 0.2, 0.3]})
    with pytest.raises(InputError, match="three components"):
        model("ggx").evaluate([1.0, 0.0], up, {})
    with pytest.raises(InputError, match="unit vector"):
        model("ggx").evaluate([0.0, 0.0, 2.0], up, {})


def test_the_table_lists_every_model():
    table = models()
    assert set(table.index) == {*LOBES, *SUMS}
    assert not table.loc["blinn-phong-classic", "reciprocal"]
    assert table["source"].str.len().min() > 5
