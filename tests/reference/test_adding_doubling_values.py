"""Adding–doubling against trusted values to 1e-6: published tables, exact solutions, seven-digit results.

Lengths below are in mm; the published cases are in cm.
"""

import math

import numpy as np
import pytest

from livlab.model.tissue.particles.sphere import mie_phase
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic, Tabulated
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.adding_doubling import adding_doubling, cone_fraction, exit_flux
from livlab.model.transport.doubling import homogeneous_layer

G0, G5, G75, G9 = Isotropic(), HenyeyGreenstein(0.5), HenyeyGreenstein(0.75), HenyeyGreenstein(0.9)
HALF_SPACE = math.inf


def one(result, name):
    return float(result[name].values.squeeze())


def two_layers(mua_below=0.5, capsule=0.1):
    layers = [(1.38, mua_below, 15.0, 50.0, G9)]
    if capsule:
        layers.insert(0, (1.36, 0.01, 10.0, capsule, G9))
    return adding_doubling(plain_stack(layers))


def h_function(albedo, mu):
    """Chandrasekhar 1960, ch. V, iterated in the stable form 1/H = √(1 − a) + (a/2) ∫ µ'H/(µ + µ') dµ'."""
    x, w = np.polynomial.legendre.leggauss(400)
    # t³ crowds the nodes at µ = 0, where H has its logarithm.
    t, w = 0.5 * (x + 1), 0.5 * w
    nodes, weights = t**3, 3 * t**2 * w
    values = np.ones_like(nodes)
    kernel = nodes * weights / (nodes[:, None] + nodes)
    for _ in range(10_000):
        new = 1 / (math.sqrt(1 - albedo) + 0.5 * albedo * (kernel @ values))
        step = np.abs(new - values).max()
        values = 0.5 * (new + values)
        if step < 1e-14:
            break
    mu = np.atleast_1d(mu)
    return 1 / (math.sqrt(1 - albedo) + 0.5 * albedo * (nodes * weights / (mu[:, None] + nodes)) @ values)


def test_case_one_slab():
    result = adding_doubling(plain_stack([(1.0, 1.0, 9.0, 0.2, G75)]))
    assert one(result, "reflectance") == pytest.approx(0.0973946, abs=1e-6)
    assert one(result, "transmittance") == pytest.approx(0.6609577, abs=1e-6)
    assert one(result, "reflectance_diffuse_incidence") == pytest.approx(0.19109, abs=6e-6)
    assert one(result, "specular") == 0.0


def test_case_two_half_space():
    result = adding_doubling(plain_stack([(1.5, 1.0, 9.0, HALF_SPACE, G0)]))
    assert one(result, "reflectance") == pytest.approx(0.2199186, abs=1e-6)
    assert one(result, "specular") == pytest.approx(0.04, abs=1e-15)
    assert one(result, "reflectance_diffuse_incidence") == pytest.approx(0.30789, abs=6e-6)


def test_case_three_two_indices():
    result = two_layers()
    assert one(result, "reflectance") == pytest.approx(0.1217318, abs=1e-6)
    assert one(result, "specular") == pytest.approx(0.0232692, abs=6e-8)
    assert one(result, "reflectance_diffuse_incidence") == pytest.approx(0.200838, abs=1e-6)
    assert one(result, "transmittance") < 1e-12


@pytest.mark.parametrize(
    ("mua_below", "capsule", "total"),
    [
        (0.05, 0.1, 0.462956),
        (0.5, 0.1, 0.145001),
        (5.0, 0.1, 0.040643),
        (0.5, 0.025, 0.134961),
        (0.5, 0.4, 0.194291),
        (0.5, 0.0, 0.1335579),
    ],
)
def test_case_three_varied(mua_below, capsule, total):
    result = two_layers(mua_below, capsule)
    assert one(result, "reflectance") + one(result, "specular") == pytest.approx(total, abs=1e-6)


@pytest.mark.parametrize(
    ("albedo", "printed"),
    [
        (0.2, 0.0352305),
        (0.5, 0.1152259),
        (0.8, 0.2852545),
        (0.9, 0.4149475),
        (0.95, 0.5355410),
        (0.98, 0.6710837),
        (0.99, 0.7527207),
        (0.999, 0.9128453),
    ],
)
@pytest.mark.parametrize("mu0", [1.0, 0.5, 0.05])
def test_isotropic_half_space_is_the_h_function(albedo, printed, mu0):
    result = adding_doubling(plain_stack([(1.0, 1 - albedo, albedo, HALF_SPACE, G0)]), mu0=mu0)
    exact = 1 - float(h_function(albedo, mu0)[0]) * math.sqrt(1 - albedo)
    assert one(result, "reflectance") == pytest.approx(exact, abs=1e-6)
    if mu0 == 1.0:
        assert exact == pytest.approx(printed, abs=6e-8)


@pytest.mark.parametrize("mu0", [1.0, 0.3])
def test_angles_of_an_isotropic_half_space(mu0):
    """L(µ) = a/(4π) H(µ) H(µ₀)/(µ + µ₀) per incident flux (Chandrasekhar 1960, ch. V)."""
    albedo = 0.9
    mu = np.array([1.0, 0.95, 0.7, 0.4, 0.1, 0.01])
    h = h_function(albedo, np.append(mu, mu0))
    want = albedo / (4 * math.pi) * h[:-1] * h[-1] * mu / (mu + mu0)
    errors = []
    for nodes in (24, 48):
        result = adding_doubling(plain_stack([(1.0, 1 - albedo, albedo, HALF_SPACE, G0)]), mu0=mu0, nodes=nodes)
        errors.append(np.abs(exit_flux(result, mu)[0].to_numpy() - want))
    # Worst at grazing exit, where the radiance has a logarithm.
    assert errors[0].max() < 1e-6
    assert errors[0][:4].max() < 2e-7
    assert errors[1].max() < 0.1 * errors[0].max()


@pytest.mark.parametrize(
    ("optical_depth", "phase", "reflected", "transmitted"), [(1.0, G0, 0.48652, 0.49163), (4.0, G5, 0.61996, 0.30605)]
)
def test_van_de_hulst_oblique(optical_depth, phase, reflected, transmitted):
    slab = plain_stack([(1.0, 0.01 * optical_depth, 0.99 * optical_depth, 1.0, phase)])
    result = adding_doubling(slab, mu0=0.5)
    assert one(result, "reflectance") == pytest.approx(reflected, abs=6e-6)
    assert one(result, "transmittance") == pytest.approx(transmitted, abs=6e-6)


@pytest.mark.parametrize("depth", [1e-6, 0.02, 1.0, 300.0])
@pytest.mark.parametrize(("mua", "mus", "g"), [(1.0, 9.0, 0.75), (1e-6, 20.0, 0.0), (0.0, 5.0, 0.9), (5.0, 1e-3, -0.5)])
def test_light_that_only_goes_up_and_down(depth, mua, mus, g):
    """One node is the exact one-dimensional problem: R = B(1 − e^(−2Dd))/[(D + A) + (D − A) e^(−2Dd)]."""
    forward = (1 + g) / 2
    A, B = mua + mus - mus * forward, mus * (1 - forward)
    D = math.sqrt(mua * (A + B))  # A − B = µ_a
    if D == 0:
        want_r, want_t = B * depth / (1 + B * depth), 1 / (1 + B * depth)
    else:
        fall = math.exp(-2 * D * depth)
        bottom = (D + A) + (D - A) * fall
        want_r, want_t = B * -math.expm1(-2 * D * depth) / bottom, 2 * D * math.sqrt(fall) / bottom
    R, T, a = homogeneous_layer(np.ones(1), np.array([[forward]]), np.array([[1 - forward]]), mua, mus, depth)
    assert R[0, 0] == pytest.approx(want_r, rel=1e-9)
    assert T[0, 0] == pytest.approx(want_t, rel=1e-9, abs=1e-100)
    assert R[0, 0] + T[0, 0] + a[0] == pytest.approx(1, abs=1e-11)


@pytest.mark.parametrize(
    "phase",
    [G9, HenyeyGreenstein(0.97), HenyeyGreenstein(-0.6), mie_phase(1.5 / 1.35, 5.0), mie_phase(1.5 / 1.35, 25.0)],
    ids=["hg.9", "hg.97", "hg-.6", "mie5", "mie25"],
)
def test_peaked_phase_functions_scatter_once_into_the_right_angles(phase):
    """A film at normal incidence: µ L(µ) = µ p(−µ) (1 − e^(−τ(1 + 1/µ)))/(1 + µ), first order in τ."""
    tau = 1e-6
    result = adding_doubling(plain_stack([(1.0, 0.0, tau, 1.0, phase)]), nodes=64, tolerance=1e-9)
    mu = np.array([0.95, 0.8, 0.6, 0.3, 0.1])
    want = mu * phase.pdf(-mu) * -np.expm1(-tau * (1 + 1 / mu)) / (1 + mu)
    # A table's corners (half a degree, a fortieth of a lobe) are not followed by polynomials in the angle.
    rtol = 2e-3 if isinstance(phase, Tabulated) else 3e-5
    np.testing.assert_allclose(exit_flux(result, mu)[0], want, rtol=rtol)
    # All that is thrown backwards: the cdf at 90°.
    assert one(result, "reflectance") == pytest.approx(tau * float(phase.cdf(np.array(0.0))), rel=2e-4)


@pytest.mark.parametrize("x", [5.0, 25.0, 100.0])
def test_mie_converges_and_does_not_depend_on_the_cut(x):
    """Spheres of collagen in their medium: the same totals with half the moments, and with 48 nodes."""
    phase = mie_phase(1.5 / 1.35, x)
    slab = plain_stack([(1.35, 0.5, 20.0, 1.0, phase)])
    result = adding_doubling(slab)
    assert bool(result.converged[0])
    fine, cut = adding_doubling(slab, nodes=48), adding_doubling(slab, order=int(4 * x) + 20)
    for name in ("reflectance", "transmittance", "reflectance_diffuse_incidence"):
        assert one(result, name) == pytest.approx(one(fine, name), abs=1e-6)
        assert one(cut, name) == pytest.approx(one(fine, name), abs=1e-6)


def test_narrow_cone_of_case_three_against_the_whole():
    result = two_layers()
    cosines = np.cos(np.radians([0.0, 10.0, 30.0, 60.0, 90.0]))
    inside = [float(cone_fraction(result, max(float(c), 0.0))[0]) for c in cosines]
    assert np.all(np.diff(inside) > 0)
    assert inside[-1] == pytest.approx(0.1217318, abs=1e-5)
