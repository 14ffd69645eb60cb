"""Kubelka–Munk: closed forms, limits, layers that add."""

import math

import pytest

from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.fresnel import diffuse_fresnel
from livlab.model.transport.kubelka_munk import kubelka_munk, kubelka_munk_layer

G0 = Isotropic()


@pytest.mark.parametrize(("K", "S", "d"), [(0.1, 2.0, 0.5), (3.0, 0.2, 1.0), (1e-7, 5.0, 2.0), (2.0, 0.0, 0.3)])
def test_against_the_hyperbolic_form(K, S, d):
    reflected, passed = kubelka_munk_layer(K, S, d)
    if S == 0:
        assert reflected == 0.0
        assert passed == pytest.approx(math.exp(-K * d))
        return
    a = 1 + K / S
    b = math.sqrt(a * a - 1)
    bottom = a * math.sinh(b * S * d) + b * math.cosh(b * S * d)
    assert reflected == pytest.approx(math.sinh(b * S * d) / bottom, rel=1e-9)
    assert passed == pytest.approx(b / bottom, rel=1e-9)


def test_limits():
    assert kubelka_munk_layer(0.0, 2.0, 3.0) == (pytest.approx(6 / 7), pytest.approx(1 / 7))
    assert kubelka_munk_layer(0.0, 2.0, math.inf) == (1.0, 0.0)
    assert kubelka_munk_layer(0.0, 0.0, 1.0) == (0.0, 1.0)
    ratio = 0.3 / 2.0
    want = 1 + ratio - math.sqrt(ratio**2 + 2 * ratio)
    assert kubelka_munk_layer(0.3, 2.0, math.inf) == (pytest.approx(want, rel=1e-14), 0.0)
    assert kubelka_munk_layer(1e-18, 1.0, 1.0) == (pytest.approx(0.5, abs=1e-12), pytest.approx(0.5, abs=1e-12))


def test_surfaces_are_saundersons():
    result = kubelka_munk(plain_stack([(1.5, 0.1, 4.0, math.inf, G0)]))
    R, _ = kubelka_munk_layer(0.2, 3.0, math.inf)
    k2 = diffuse_fresnel(1.5, 1.0)
    assert float(result.reflectance[0]) == pytest.approx(0.96 * (1 - k2) * R / (1 - k2 * R), rel=1e-12)
    assert float(result.specular[0]) == pytest.approx(0.04)


def test_a_layer_cut_in_two_is_the_layer():
    layer = (1.4, 0.05, 5.0, 1.0, HenyeyGreenstein(0.5))
    half = (1.4, 0.05, 5.0, 0.5, HenyeyGreenstein(0.5))
    whole, parts = kubelka_munk(plain_stack([layer])), kubelka_munk(plain_stack([half, half]))
    for name in ("reflectance", "transmittance", "reflectance_diffuse_incidence", "transmittance_diffuse_incidence"):
        assert float(whole[name][0]) == pytest.approx(float(parts[name][0]), rel=1e-12)


def test_no_absorption_loses_nothing():
    result = kubelka_munk(plain_stack([(1.4, 0.0, 5.0, 1.0, G0), (1.3, 0.0, 2.0, 3.0, G0)], n_below=1.2))
    assert float(result.absorbed[0]) == pytest.approx(0.0, abs=1e-14)
    diffuse = result.reflectance_diffuse_incidence + result.transmittance_diffuse_incidence
    assert float(diffuse[0]) == pytest.approx(1.0, abs=1e-14)


def test_domain_flag():
    assert bool(kubelka_munk(plain_stack([(1.4, 0.01, 5.0, 1.0, G0)])).valid[0])
    assert not bool(kubelka_munk(plain_stack([(1.4, 1.0, 5.0, 1.0, G0)])).valid[0])
    assert not bool(kubelka_munk(plain_stack([(1.4, 0.1, 0.0, math.inf, G0)])).valid[0])
    assert not bool(kubelka_munk(plain_stack([(1.4, 0.01, 5.0, 0.5, G0)])).valid[0])
    assert not bool(kubelka_munk(plain_stack([(1.4, 0.0, 0.0, 1.0, G0)])).valid[0])


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: kubelka_munk_layer(-1.0, 1.0, 1.0), "K"),
        (lambda: kubelka_munk_layer(1.0, math.nan, 1.0), "S"),
        (lambda: kubelka_munk_layer(1.0, 1.0, 0.0), "thickness_mm"),
        (lambda: kubelka_munk(plain_stack([(1.4, 0.0, 5.0, 1.0, G0)]), mu0=2.0), "mu0"),
    ],
)
def test_bad_input(call, field):
    with pytest.raises(InputError, match=field):
        call()
