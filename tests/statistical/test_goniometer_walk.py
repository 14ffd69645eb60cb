"""The virtual goniometer against closed forms and against physics it must obey."""

import numpy as np
import pytest

from livlab.acquire.instruments.goniometer import Detectors, collinear, goniometer
from livlab.errors import InputError
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.model.transport.adding_doubling import adding_doubling, exit_flux

DETECTORS = Detectors(10.0, 30.0)


def h_function(mu, albedo, nodes=200):
    """Chandrasekhar's H for isotropic scattering: 1/H = √(1 − a) + a/2 ∫ µ' H(µ')/(µ + µ') dµ'."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2, w / 2
    h = np.ones(nodes)
    for _ in range(4000):
        new = 1 / (np.sqrt(1 - albedo) + albedo / 2 * (w * x * h / (x[:, None] + x)).sum(1))
        if np.abs(new - h).max() < 1e-13:
            break
        h = new
    return 1 / (np.sqrt(1 - albedo) + albedo / 2 * (w * x * h / (np.atleast_1d(mu)[..., None] + x)).sum(-1))


def detector_means(f):
    """Mean of f(µ) over each detector's polar range, weighted by its projected solid angle."""
    x, w = np.polynomial.legendre.leggauss(24)
    square = np.sin(DETECTORS.theta_edges) ** 2
    at = (square[1:] + square[:-1])[:, None] / 2 + x * np.diff(square)[:, None] / 2
    return (f(np.sqrt(1 - at)) * w / 2).sum(-1)


@pytest.mark.parametrize("albedo", [0.5, 0.95])
def test_an_isotropic_half_space_has_the_brdf_of_the_h_function(albedo):
    stack = plain_stack([(1.0, 1 - albedo, albedo, np.inf, Isotropic())])
    theta_i = np.radians([0.0, 45.0, 75.0])
    measured = goniometer(stack, theta_i, DETECTORS, samples=1_500_000, seed=11)
    z, power = [], []
    for k, mu0 in enumerate(np.cos(theta_i)):
        # f = a/(4π) H(µ) H(µ0)/(µ + µ0) (Chandrasekhar 1960, § 34), f = L/(π F µ0)
        known = detector_means(
            lambda mu, m=mu0: albedo / (4 * np.pi) * h_function(mu, albedo) * h_function(m, albedo) / (mu + m)
        )
        value, error = measured.brdf[0, k].to_numpy(), measured.brdf_se[0, k].to_numpy()
        z.append((value - known[:, None]) / error)
        power.append(np.median(error / value))
    z = np.array(z)
    assert np.max(power) < 0.05  # a detector that reads 5 % wrong would show as a standard error
    chi_square, n = (z**2).sum(), z.size
    assert abs(chi_square - n) < 4 * np.sqrt(2 * n)
    assert np.abs(z).max() < 4.5


def test_detectors_together_hold_the_reflectance_and_agree_with_adding_doubling():
    stack = plain_stack([(1.4, 0.05, 1.0, np.inf, HenyeyGreenstein(0.7))])
    theta_i = np.radians([60.0])
    measured = goniometer(stack, theta_i, DETECTORS, samples=1_500_000, seed=3)
    assert measured.integral.to_numpy() == pytest.approx(measured.reflectance.to_numpy(), rel=1e-12)
    exact = adding_doubling(stack, mu0=0.5)
    mean = detector_means(lambda mu: exit_flux(exact, mu.ravel())[0].to_numpy().reshape(mu.shape) / mu)
    weight = DETECTORS.projected_solid_angle
    value = (measured.brdf[0, 0] * weight).sum("phi") / weight.sum(1)
    error = np.sqrt(((measured.brdf_se[0, 0] * weight) ** 2).sum("phi")) / weight.sum(1)
    z = ((value - mean) / error).to_numpy()
    assert (error / value).max() < 0.03
    assert np.abs(z).max() < 4
    assert abs(float(measured.reflectance[0, 0] - exact.reflectance[0])) < 4 * float(measured.reflectance_se[0, 0])


def test_azimuth_follows_the_light_and_obeys_reciprocity():
    stack = plain_stack([(1.0, 1.0, 0.5, np.inf, HenyeyGreenstein(0.6))])
    angles = np.radians([30.0, 60.0])
    g = goniometer(stack, angles, DETECTORS, samples=3_000_000, seed=5)
    f, se = g.brdf[0], g.brdf_se[0]
    # Forward scattering sends more to the mirror's side than back to the light.
    retro, mirror = f.isel(theta_o=6, phi=0), f.isel(theta_o=6, phi=-1)
    assert (mirror > 1.5 * retro).all()
    forth, back = f.isel(theta_i=0, theta_o=6), f.isel(theta_i=1, theta_o=3)
    error = np.hypot(se.isel(theta_i=0, theta_o=6), se.isel(theta_i=1, theta_o=3))
    # A 10° detector differs from its centre by less than 1 % here, on top of the noise.
    assert (np.abs(forth - back) < 4 * error + 0.01 * back).all()
    assert float((error / back).max()) < 0.06


def test_single_scattering_has_the_phase_function_in_its_azimuth():
    """f = a p(Θ)/(µ + µ0) of a half-space that scatters a little (Chandrasekhar 1960, § 44), up to order a²."""
    albedo, g = 0.02, 0.5
    phase = HenyeyGreenstein(g)
    stack = plain_stack([(1.0, 1 - albedo, albedo, np.inf, phase)])
    fine = Detectors(10.0, 15.0)
    measured = goniometer(stack, np.radians([45.0]), fine, samples=6_000_000, seed=9)
    k = 4
    x, w = np.polynomial.legendre.leggauss(12)
    theta = (fine.theta_edges[k] + fine.theta_edges[k + 1]) / 2 + x * np.diff(fine.theta_edges)[k] / 2
    value, error = measured.brdf[0, 0, k].to_numpy(), measured.brdf_se[0, 0, k].to_numpy()
    for p in range(len(fine.phi)):
        phi = (fine.phi_edges[p] + fine.phi_edges[p + 1]) / 2 + x * np.diff(fine.phi_edges)[p] / 2
        t, q = np.meshgrid(theta, phi, indexing="ij")
        weight = np.outer(w * np.sin(theta) * np.cos(theta), w)
        # φ = 0 is where the light comes from: there light turns by almost π.
        cos_turn = -np.cos(t) * np.cos(np.pi / 4) - np.sin(t) * np.sin(np.pi / 4) * np.cos(q)
        f = albedo * phase.pdf(cos_turn.ravel()).reshape(t.shape) / (np.cos(t) + np.cos(np.pi / 4))
        known = (f * weight).sum() / weight.sum()
        assert error[p] / known < 0.04
        assert abs(value[p] - known) < 4 * error[p] + 1.5 * albedo * known


def test_collinear_reads_the_detector_at_the_light():
    stack = plain_stack([(1.0, 1.0, 1.0, np.inf, Isotropic())])
    g = goniometer(stack, np.radians([0.0, 30.0]), DETECTORS, samples=20_000, seed=1)
    line = collinear(g)
    assert line.brdf.sizes == {"wavelength": 1, "theta_i": 2}
    assert float(line.brdf[0, 1]) == float(g.brdf[0, 1, 3, 0])
    off = goniometer(stack, np.radians([33.0]), DETECTORS, samples=1_000, seed=1)
    with pytest.raises(InputError, match="no detector centred on it"):
        collinear(off)


def test_an_angle_has_its_own_stream_whatever_other_angles_there_are():
    stack = plain_stack([(1.0, 1.0, 1.0, np.inf, Isotropic())])
    alone = goniometer(stack, [0.5], DETECTORS, samples=20_000, seed=4)
    both = goniometer(stack, [0.2, 0.5], DETECTORS, samples=20_000, seed=4)
    assert np.array_equal(alone.brdf[0, 0], both.brdf[0, 1])
    assert not np.array_equal(both.brdf[0, 0], both.brdf[0, 1])


@pytest.mark.parametrize(("theta", "phi"), [(7.0, 30.0), (5.0, 50.0), (0.0, 30.0), (180.0, 30.0)])
def test_steps_must_divide(theta, phi):
    with pytest.raises(InputError, match="must divide"):
        Detectors(theta, phi)


def test_detectors_tile_the_hemisphere():
    assert DETECTORS.projected_solid_angle.sum() == pytest.approx(np.pi)
    assert DETECTORS.projected_solid_angle.shape == (len(DETECTORS.theta), len(DETECTORS.phi))
