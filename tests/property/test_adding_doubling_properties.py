"""Adding–doubling: what must hold for any stack."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from livlab.model.tissue.phase.functions import HenyeyGreenstein
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.adding_doubling import adding_doubling, exit_flux

SETTINGS = settings(max_examples=40, deadline=None, derandomize=True)


def log_uniform(low, high):
    return st.floats(math.log10(low), math.log10(high)).map(lambda x: 10.0**x)


# Either 0 or a size that thin layers and thick ones both meet.
COEFFICIENT = st.one_of(st.just(0.0), log_uniform(1e-6, 1e4))
LAYER = st.tuples(
    st.floats(0.8, 2.0),
    COEFFICIENT,
    COEFFICIENT,
    log_uniform(1e-4, 1e2),
    st.floats(-0.9, 0.95).map(HenyeyGreenstein),
)
STACK = st.lists(LAYER, min_size=1, max_size=4)
INDEX = st.floats(0.9, 1.8)
COSINE = st.one_of(st.just(1.0), st.floats(0.01, 1.0))


def one(result, name):
    return float(result[name].values.squeeze())


@SETTINGS
@given(STACK, INDEX, INDEX, COSINE)
def test_energy_and_signs(layers, n_above, n_below, mu0):
    result = adding_doubling(plain_stack(layers, n_above=n_above, n_below=n_below), mu0=mu0, nodes=12)
    assert abs(one(result, "residual")) < 1e-9
    diffuse = (
        one(result, "reflectance_diffuse_incidence")
        + one(result, "transmittance_diffuse_incidence")
        + float(result.absorbed_diffuse_incidence.sum())
    )
    assert abs(diffuse - 1) < 1e-9
    for name in ("reflectance", "transmittance", "unscattered_transmittance", "unscattered_reflectance"):
        assert -1e-12 <= one(result, name) <= 1 + 1e-12
    assert (result.absorbed >= -1e-12).all()
    dark = [k for k, layer in enumerate(layers) if layer[1] == 0.0]
    assert (np.abs(result.absorbed.values[0, dark]) < 1e-12).all()


@SETTINGS
@given(STACK, st.integers(0, 3), st.floats(0.01, 0.99), COSINE)
def test_a_layer_cut_in_two_is_the_layer(layers, which, where, mu0):
    k = which % len(layers)
    n, mua, mus, d, phase = layers[k]
    cut = [*layers[:k], (n, mua, mus, where * d, phase), (n, mua, mus, (1 - where) * d, phase), *layers[k + 1 :]]
    whole, parts = (adding_doubling(plain_stack(x), mu0=mu0, nodes=12) for x in (layers, cut))
    for name in (
        "reflectance",
        "transmittance",
        "reflectance_diffuse_incidence",
        "transmittance_diffuse_incidence",
        "unscattered_transmittance",
    ):
        assert abs(one(whole, name) - one(parts, name)) < 1e-9
    np.testing.assert_allclose(parts.reflectance_angular, whole.reflectance_angular, atol=1e-8)
    assert abs(float(parts.absorbed[0, k : k + 2].sum() - whole.absorbed[0, k])) < 1e-9


@SETTINGS
@given(STACK, INDEX, INDEX)
def test_reciprocity_of_diffuse_transmission(layers, n_above, n_below):
    """Isotropic radiance from either side: n² T is the same both ways (étendue)."""
    down = adding_doubling(plain_stack(layers, n_above=n_above, n_below=n_below), nodes=12)
    up = adding_doubling(plain_stack(layers[::-1], n_above=n_below, n_below=n_above), nodes=12)
    here = n_above**2 * one(down, "transmittance_diffuse_incidence")
    there = n_below**2 * one(up, "transmittance_diffuse_incidence")
    assert abs(here - there) < 1e-4 * max(here, there) + 1e-12


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    st.lists(
        st.tuples(
            st.floats(1.3, 1.6),
            log_uniform(1e-3, 1),
            log_uniform(1e-1, 30),
            log_uniform(1e-1, 10),
            st.floats(-0.5, 0.8).map(HenyeyGreenstein),
        ),
        min_size=1,
        max_size=3,
    ),
    st.floats(0.1, 1.0),
    st.floats(0.1, 1.0),
)
def test_reciprocity_of_reflection(layers, mu_a, mu_b):
    """The BRDF L/E is the same with light and eye exchanged (Helmholtz)."""
    stack = plain_stack(layers)
    ab = float(exit_flux(adding_doubling(stack, mu0=mu_a, nodes=32), np.array([mu_b]))[0, 0]) / mu_b
    ba = float(exit_flux(adding_doubling(stack, mu0=mu_b, nodes=32), np.array([mu_a]))[0, 0]) / mu_a
    assert abs(ab - ba) < 2e-5 * max(ab, ba)


@SETTINGS
@given(LAYER, log_uniform(1e-3, 1e3), COSINE)
def test_only_optical_depth_counts(layer, scale, mu0):
    n, mua, mus, d, phase = layer
    a = adding_doubling(plain_stack([layer]), mu0=mu0, nodes=8)
    b = adding_doubling(plain_stack([(n, mua * scale, mus * scale, d / scale, phase)]), mu0=mu0, nodes=8)
    for name in ("reflectance", "transmittance", "absorbed"):
        assert abs(one(a, name) - one(b, name)) < 1e-9


@SETTINGS
@given(LAYER, st.floats(1.01, 3.0))
def test_more_absorption_returns_less(layer, factor):
    n, mua, mus, d, phase = layer
    a = adding_doubling(plain_stack([layer]), nodes=12)
    b = adding_doubling(plain_stack([(n, mua * factor, mus, d, phase)]), nodes=12)
    for name in ("reflectance", "transmittance", "reflectance_diffuse_incidence"):
        assert one(b, name) <= one(a, name) + 1e-12
