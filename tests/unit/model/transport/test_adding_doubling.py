"""Adding–doubling: exact limits, hard corners, the result's form, and what it refuses."""

import math

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Rayleigh
from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer, plain_stack
from livlab.model.transport.adding_doubling import adding_doubling, cone_fraction, exit_flux
from livlab.model.transport.doubling import _round_trips
from livlab.model.transport.fresnel import incoherent_stack

G9 = HenyeyGreenstein(0.9)
G0 = Isotropic()


def one(result, name):
    return float(result[name].values.squeeze())


def balance(result):
    return (
        float(result.residual[0]),
        1
        - one(result, "reflectance_diffuse_incidence")
        - one(result, "transmittance_diffuse_incidence")
        - float(result.absorbed_diffuse_incidence.sum()),
    )


@pytest.mark.parametrize("mu0", [1.0, 0.4, 1e-3])
@pytest.mark.parametrize("depth", [0.0, 1e-8, 0.7, 30.0])
def test_without_scattering_it_is_plates(mu0, depth):
    stack = plain_stack([(1.5, depth, 0.0, 1.0, G0), (1.36, 0.3, 0.0, 2.0, G0)], n_below=1.2)
    result = adding_doubling(stack, mu0=mu0)
    up, down = incoherent_stack([1.0, 1.5, 1.36, 1.2], mu0, [depth, 0.6])
    assert one(result, "specular") + one(result, "reflectance") == pytest.approx(up, abs=1e-14)
    assert one(result, "transmittance") == pytest.approx(down, rel=1e-12)
    assert one(result, "unscattered_transmittance") == pytest.approx(down, rel=1e-12)
    assert float(np.abs(result.reflectance_angular).max()) == 0.0


def test_nothing_at_all():
    result = adding_doubling(plain_stack([(1.0, 0.0, 0.0, 1.0, G0)]))
    assert one(result, "transmittance") == 1.0
    assert one(result, "reflectance") == 0.0
    assert one(result, "transmittance_diffuse_incidence") == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("tau", [1e-8, 1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("loss", [0.0, 1e-9, 0.5, 1 - 1e-9])
def test_energy_at_extreme_depths_and_albedos(tau, loss):
    result = adding_doubling(plain_stack([(1.4, tau * loss, tau * (1 - loss), 1.0, HenyeyGreenstein(0.8))]))
    assert bool(result.converged[0])
    for name in ("reflectance", "transmittance", "absorbed", "reflectance_diffuse_incidence"):
        assert one(result, name) >= 0.0
    np.testing.assert_allclose(balance(result), 0.0, atol=1e-9)
    if loss == 0.0:
        assert one(result, "absorbed") == 0.0


def test_thin_layer_scatters_once():
    """R of an index-matched film is first order: its optical depth times the share thrown backwards."""
    tau = 1e-7
    result = adding_doubling(plain_stack([(1.0, 0.0, tau, 1.0, Rayleigh())]))
    assert one(result, "reflectance") == pytest.approx(tau / 2, rel=1e-5)
    assert one(result, "transmittance") == pytest.approx(1 - tau / 2, abs=1e-12)
    # Weak absorption keeps its own digits beside an albedo of nearly 1.
    faint = adding_doubling(plain_stack([(1.0, 1e-12, 1e-3, 1.0, Rayleigh())]))
    assert one(faint, "absorbed") == pytest.approx(1e-12, rel=2e-2)


def test_conservative_half_space_returns_everything():
    result = adding_doubling(plain_stack([(1.4, 0.0, 10.0, math.inf, G9)]))
    assert one(result, "reflectance") + one(result, "specular") == pytest.approx(1.0, abs=1e-9)
    assert one(result, "reflectance_diffuse_incidence") == pytest.approx(1.0, abs=1e-9)
    assert one(result, "transmittance") == 0.0


def test_half_space_is_the_limit_of_a_thick_slab():
    deep = adding_doubling(plain_stack([(1.4, 0.1, 10.0, math.inf, G9)]), nodes=16)
    thick = adding_doubling(plain_stack([(1.4, 0.1, 10.0, 200.0, G9)], n_below=1.4), nodes=16)
    assert one(deep, "reflectance") == pytest.approx(one(thick, "reflectance"), abs=1e-12)


def test_clear_infinite_layer_is_a_medium_that_light_leaves_into():
    result = adding_doubling(plain_stack([(1.5, 0.0, 0.0, math.inf, G0)]))
    assert one(result, "transmittance") == pytest.approx(0.96, abs=1e-14)
    np.testing.assert_allclose(balance(result), 0.0, atol=1e-12)


@pytest.mark.parametrize("mu0", [1.0, 0.3])
def test_clear_plate_over_tissue_traps_no_light_it_never_got(mu0):
    result = adding_doubling(plain_stack([(1.6, 0.0, 0.0, 1.0, G0), (1.4, 0.0, 9.0, 1.0, G9)]), mu0=mu0)
    np.testing.assert_allclose(balance(result), 0.0, atol=1e-10)
    assert np.isfinite(result.reflectance_angular).all()


@pytest.mark.parametrize("mu0", [1.0, 0.55, 0.3, 1e-5])
def test_rare_layers(mu0):
    """Layers of n < 1 between denser ones: light beyond the critical angle never enters them."""
    stack = plain_stack([(0.8, 0.1, 5.0, 0.2, G9), (1.4, 0.2, 5.0, 0.3, G9), (0.9, 0.0, 1.0, 0.5, G9)], n_below=1.3)
    result = adding_doubling(stack, mu0=mu0)
    np.testing.assert_allclose(balance(result), 0.0, atol=1e-11)
    if mu0 < 0.6:
        assert one(result, "specular") == 1.0
        assert abs(one(result, "reflectance")) < 1e-14


@pytest.mark.parametrize("step", [1e-7, 1e-6, 1e-5, 1e-4, 1e-3])
def test_near_match_is_continuous(step):
    """An index nearly matched changes fluxes as little as it should; nodes that miss the corner fail here."""
    matched = adding_doubling(plain_stack([(1.0, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))]), nodes=24)
    near = adding_doubling(plain_stack([(1.0 + step, 1.0, 9.0, 0.2, HenyeyGreenstein(0.75))]))
    for name in ("reflectance", "transmittance", "reflectance_diffuse_incidence"):
        assert one(near, name) == pytest.approx(one(matched, name), abs=2e-6 + 1.5 * step)


def test_order_of_layers_matters():
    a, b = (1.36, 0.01, 10.0, 0.1, G9), (1.38, 0.5, 15.0, 1.0, G9)
    up = one(adding_doubling(plain_stack([a, b])), "reflectance")
    down = one(adding_doubling(plain_stack([b, a])), "reflectance")
    assert abs(up - down) > 0.005


def test_error_estimate_covers_the_error():
    """Over sixty slabs the truth (96 nodes) lies within the estimate."""
    rng = np.random.default_rng(7)
    worst = 0.0
    names = ("reflectance", "transmittance", "reflectance_diffuse_incidence", "transmittance_diffuse_incidence")
    for _ in range(60):
        n, g = rng.uniform(1.0, 1.6), rng.uniform(-0.5, 0.97)
        mua, mus = 10 ** rng.uniform(-3, 1), 10 ** rng.uniform(-2, 1.5)
        mu0 = rng.choice([1.0, rng.uniform(0.05, 1)])
        layers = [(n, mua, mus, 0.3, HenyeyGreenstein(g))]
        result = adding_doubling(plain_stack(layers), mu0=mu0, tolerance=1e-4)
        truth = adding_doubling(plain_stack(layers), mu0=mu0, nodes=40)
        error = max(abs(one(result, x) - one(truth, x)) for x in names)
        worst = max(worst, error / one(result, "error_estimate"))
    assert worst < 1.0


def test_short_free_paths_absorb_in_the_mean():
    w = np.array([500.0])
    u = np.ones(1)
    plain = Interaction("s", 3.0 * u, u, (G0,))
    short = Interaction("h", 5.0 * u, u, (G0,), absorb_below_mm=0.1)
    stack = OpticalStack(w, (PlaneLayer("x", 1.0, 1.3 * u, (plain, short)),), u, u)
    passed = math.exp(-8.0 * 0.1)
    same = plain_stack([(1.3, 5.0 * (1 - passed), 3.0 + 5.0 * passed, 1.0, G0)])
    result = adding_doubling(stack)
    assert one(result, "reflectance") == pytest.approx(one(adding_doubling(same), "reflectance"), abs=1e-12)
    assert "short free paths" in result.attrs["notes"]


def test_redirect_factors_count_as_their_mean():
    u = np.ones(1)
    stack = OpticalStack(
        np.array([500.0]),
        (PlaneLayer("x", 1.0, 1.3 * u, (Interaction("s", 3.0 * u, u, (G0,), redirect="abs_cos"),)),),
        u,
        u,
    )
    same = plain_stack([(1.3, 3 * (1 - 2 / math.pi), 6 / math.pi, 1.0, G0)])
    assert one(adding_doubling(stack), "reflectance") == pytest.approx(
        one(adding_doubling(same), "reflectance"), abs=1e-12
    )


def test_spectrum_is_its_wavelengths_one_by_one():
    w = np.array([500.0, 600.0, 700.0])
    mua, mus, n = np.array([2.0, 0.1, 0.0]), np.array([9.0, 8.0, 7.0]), np.array([1.39, 1.38, 1.37])
    layer = PlaneLayer(
        "x", 0.5, n, (Interaction("a", mua, 0 * mua, (G9,) * 3), Interaction("s", mus, 0 * mus + 1, (G9,) * 3))
    )
    stack = OpticalStack(w, (layer,), np.ones(3), np.ones(3))
    whole = adding_doubling(stack)
    assert whole.reflectance.dims == ("wavelength",)
    assert whole.absorbed.dims == ("wavelength", "layer")
    for k in range(3):
        single = adding_doubling(plain_stack([(n[k], mua[k], mus[k], 0.5, G9)]))
        assert float(whole.reflectance[k]) == pytest.approx(one(single, "reflectance"), abs=1e-14)


def test_cones():
    result = adding_doubling(plain_stack([(1.4, 0.1, 10.0, 1.0, G9)]))
    scattered = one(result, "reflectance") - one(result, "unscattered_reflectance")
    assert float(cone_fraction(result, 0.0)[0]) == pytest.approx(scattered, rel=1e-10)
    assert float(cone_fraction(result, 1.0)[0]) == 0.0
    assert float((result.reflectance_angular * result.solid_angle).sum()) == pytest.approx(scattered, rel=1e-10)
    # A narrow cone is its solid angle times the flux per solid angle at the normal.
    narrow = math.cos(math.radians(0.5))
    axis = float(exit_flux(result, np.array([1.0]))[0, 0])
    assert float(cone_fraction(result, narrow)[0]) == pytest.approx(2 * math.pi * (1 - narrow) * axis, rel=1e-3)
    below = float((result.transmittance_angular * result.solid_angle_below).sum())
    assert below == pytest.approx(one(result, "transmittance") - one(result, "unscattered_transmittance"), rel=1e-9)


def test_cone_with_a_rare_layer_on_top():
    result = adding_doubling(plain_stack([(0.8, 0.0, 5.0, 0.2, G9), (1.4, 0.2, 5.0, 0.3, G9)]))
    scattered = one(result, "reflectance") - one(result, "unscattered_reflectance")
    assert float(cone_fraction(result, 0.0)[0]) == pytest.approx(scattered, rel=1e-9)
    # Nothing comes out beyond the critical angle of the rare layer, sin θ = 0.8.
    assert float(cone_fraction(result, 0.6)[0]) == pytest.approx(scattered, rel=1e-9)


def test_elimination_without_subtraction_keeps_digits():
    """A nearly closed room: 1 − Q is singular to 1e-14, the answer keeps eleven digits."""
    rng = np.random.default_rng(3)
    loss = 1e-14 * rng.uniform(0.5, 1.5, 6)
    share = rng.uniform(0.1, 1.0, (6, 6))
    Q = share / share.sum(axis=0) * (1 - loss)
    x = _round_trips(Q, loss, np.eye(6))
    # What enters must be lost in the end: loss · x = 1 for every column.
    np.testing.assert_allclose(loss @ x, 1.0, rtol=1e-12)


@pytest.mark.parametrize(
    ("kwargs", "field"),
    [
        ({"mu0": 0.0}, "mu0"),
        ({"mu0": 1.1}, "mu0"),
        ({"mu0": math.nan}, "mu0"),
        ({"nodes": 3}, "nodes"),
        ({"nodes": 8.5}, "nodes"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"tolerance": math.nan}, "tolerance"),
        ({"order": 0}, "order"),
    ],
)
def test_bad_input(kwargs, field):
    with pytest.raises(InputError, match=field):
        adding_doubling(plain_stack([(1.4, 0.1, 1.0, 1.0, G0)]), **kwargs)


def test_bad_directions():
    result = adding_doubling(plain_stack([(1.4, 0.1, 1.0, 1.0, G0)]))
    with pytest.raises(InputError, match="mu_min"):
        cone_fraction(result, 1.5)
    with pytest.raises(InputError, match="mu_o"):
        exit_flux(result, np.array([-0.1]))


def test_survives_netcdf(tmp_path):
    import xarray as xr

    result = adding_doubling(plain_stack([(1.4, 0.1, 10.0, 1.0, G9)]))
    result.to_netcdf(tmp_path / "r.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "r.nc", engine="h5netcdf") as back:
        assert float(cone_fraction(back, 0.9)[0]) == float(cone_fraction(result, 0.9)[0])
