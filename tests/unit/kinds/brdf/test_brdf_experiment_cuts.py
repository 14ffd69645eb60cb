"""Cuts through samples of a BRDF: angles by hand, bins, and the goniometer's own."""

import numpy as np
import pytest
import xarray as xr

from livlab.acquire.instruments.goniometer import Detectors
from livlab.brdf.samples import sample_dataset
from livlab.kinds.brdf.cuts import at_angles, cut_angles, flat_cut, half_angle_map, lobes, plane_angles, sphere_cut

RNG = np.random.default_rng(4)


def towards(theta_deg, phi_deg=0.0):
    t, p = np.radians(theta_deg), np.radians(phi_deg)
    return np.stack(np.broadcast_arrays(np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)), axis=-1)


def random_samples(count, value, *, largest=80.0, error=0.1):
    theta = np.degrees(np.arcsin(np.sqrt(RNG.random((2, count)) * np.sin(np.radians(largest)) ** 2)))
    phi = RNG.random((2, count)) * 360
    wi, wo = towards(theta[0], phi[0]), towards(theta[1], phi[1])
    found = value(wi, wo)
    return sample_dataset(wi, wo, found, standard_error=np.full_like(found, error))


def test_angles_by_hand():
    at = plane_angles(towards([30.0, 30.0, 30.0]), towards([45.0, 45.0, 45.0], [0.0, 180.0, 90.0]))
    assert np.degrees(at.signed)[:2] == pytest.approx([-45.0, 45.0])
    assert np.degrees(at.phi) == pytest.approx([0.0, 180.0, 90.0])
    assert np.degrees(at.between)[:2] == pytest.approx([15.0, 75.0])
    assert np.degrees(at.out_of_plane) == pytest.approx([0.0, 0.0, 45.0], abs=1e-9)


def test_lobes_keep_a_mirror_peak_in_place_and_leave_blanks():
    def peak(wi, wo):
        at = plane_angles(wi, wo)
        return np.exp(-(((at.signed - at.theta_i) / 0.05) ** 2))[:, None] * [[1.0, 2.0]]

    made = lobes(random_samples(400_000, peak), {"true": peak}, [30.0, 89.0])
    measured = made["measured"].isel(incidence=0, channel=1).to_numpy()
    k = int(np.nanargmax(measured))
    assert float(made["at_theta"][0, k]) == pytest.approx(30.0, abs=0.5)
    line = made["true"].isel(incidence=0, channel=1)
    assert float(made["line"][int(np.argmax(line.to_numpy()))]) == pytest.approx(30.0)
    assert float(line.max()) == pytest.approx(2.0, rel=1e-3)
    assert np.isnan(made["measured"].isel(incidence=1)).all()


def test_a_sphere_cut_reads_what_a_goniometers_detectors_would():
    def smooth(wi, wo):
        at = plane_angles(wi, wo)
        return (0.1 + 0.05 * np.cos(at.signed) + 0.02 * at.signed)[:, None]

    samples = random_samples(600_000, smooth, error=0.1)
    cut = sphere_cut(samples, "incidence", incidence_deg=45.0, last_deg=70.0)
    assert cut.angle_deg.tolist() == list(range(-70, 75, 5))
    here = cut.count > 50
    signed = np.radians(cut.at_deg[here])
    known = 0.1 + 0.05 * np.cos(signed) + 0.02 * signed
    # Straight above both signs of θ_o share the bin; elsewhere a bin's mean is its middle's value.
    off = np.abs(cut.angle_deg[here]) > 0
    assert cut.value[0, here][off] == pytest.approx(known[off], abs=1e-4)
    assert cut.error[0, here] == pytest.approx(0.1 / np.sqrt(cut.count[here]))


def test_a_collinear_cut_takes_samples_by_the_angle_between():
    samples = random_samples(400_000, lambda wi, wo: plane_angles(wi, wo).between[:, None])
    cut = sphere_cut(samples, "collinear", half_width_deg=3.0, last_deg=60.0, theta_step_deg=10.0)
    assert cut.angle_deg.tolist() == [0, 10, 20, 30, 40, 50, 60]
    assert np.nanmax(cut.value) <= np.radians(3.0)
    assert (cut.count[1:] > 20).all()


def test_thin_bins_stay_empty():
    cut = sphere_cut(random_samples(200, lambda wi, wo: np.ones((len(wi), 1))), "incidence", least=10)
    assert np.isnan(cut.value[0, cut.count < 10]).all()
    assert (cut.count < 10).any()


def flat(value):
    """A goniometer's result with value(θ_i, signed θ_o)."""
    d = Detectors(10.0, 90.0)
    theta_i = np.radians([0.0, 30.0, 40.0])
    shape = (1, 3, len(d.theta), len(d.phi))
    brdf = np.zeros(shape)
    for p, sign in enumerate((-1.0, 0.0, 1.0)):
        brdf[0, :, :, p] = value(theta_i[:, None], sign * d.theta)
    return xr.Dataset(
        {
            "brdf": (("wavelength", "theta_i", "theta_o", "phi"), brdf),
            "brdf_se": (("wavelength", "theta_i", "theta_o", "phi"), 0.01 * brdf),
        },
        coords={
            "theta_i": theta_i,
            "theta_o": ("theta_o", d.theta, {"edges": d.theta_edges}),
            "phi": ("phi", d.phi, {"edges": d.phi_edges}),
        },
    )


def test_the_goniometers_cuts():
    measured = flat(lambda i, o: 1.0 + i + 0.5 * o)
    cut = flat_cut(measured, "incidence", incidence_deg=30.0, last_deg=60.0)
    assert cut.value[0] == pytest.approx(1.0 + np.radians(30) + 0.5 * np.radians(cut.angle_deg))
    value, error = at_angles(cut, np.array([-35.0, 12.5]))
    assert value[0] == pytest.approx(1.0 + np.radians(30) + 0.5 * np.radians([-35.0, 12.5]))
    assert (error > 0).all()
    line = flat_cut(measured, "collinear", last_deg=0.0)
    assert line.angle_deg.tolist() == [0.0]
    assert line.value[0, 0] == pytest.approx(1.0)


def test_cut_angles_have_two_sides_or_one():
    assert cut_angles("incidence", 12.0, 5.0).tolist() == [-10.0, -5.0, 0.0, 5.0, 10.0]
    assert cut_angles("collinear", 12.0, 5.0).tolist() == [0.0, 5.0, 10.0]


def test_half_angle_maps_count_every_sample_and_blank_the_rest():
    samples = random_samples(5_000, lambda wi, wo: np.ones((len(wi), 1)))
    made = half_angle_map(samples, np.full((5_000, 1), 0.02))
    assert int(made["cell_count"].sum()) == 5_000
    filled = made["cell_count"] > 0
    assert np.allclose(made["cell_error"].to_numpy()[filled], 0.02)
    assert np.isnan(made["cell_error"].to_numpy()[~filled]).all()
