"""Pictures of spheres of tissue: against closed forms, against the flat sample, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from livlab.acquire.instruments.goniometer import goniometer, unoriented
from livlab.acquire.instruments.sphere_rig import SphereRig, arc, moved, ring
from livlab.acquire.instruments.sphere_rig_tissue import photograph_tissue
from livlab.brdf.sphere import extract
from livlab.errors import InputError
from livlab.kinds.brdf.cuts import at_angles, flat_cut, sphere_cut
from livlab.model.tissue.phase.functions import HenyeyGreenstein, Isotropic
from livlab.model.tissue.stack import plain_stack
from livlab.model.tracer.rig_tissue import exits, pictures


def rig(spp, **options):
    lights = arc(8, last_deg=115.0, distance_radii=math.inf, channels=1)
    return SphereRig.make(lights, radius_px=30, radius_mm=40, silhouette="none", samples_per_pixel=spp, **options)


def h_function(mu, albedo, nodes=100):
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2, w / 2
    h = np.ones(nodes)
    for _ in range(2000):
        h = 1 / (np.sqrt(1 - albedo) + albedo / 2 * (w * x * h / (x[:, None] + x)).sum(1))
    return 1 / (np.sqrt(1 - albedo) + albedo / 2 * (w * x * h / (np.asarray(mu)[..., None] + x)).sum(-1))


@pytest.mark.parametrize("camera_radii", [4.0, 20.0])
def test_an_isotropic_sphere_has_the_brdf_of_the_h_function(camera_radii):
    """Mean free path 0.1 mm on a radius of 40 mm: a flat half-space to a few thousandths."""
    albedo = 0.8
    stack = plain_stack([(1.0, 10 * (1 - albedo), 10 * albedo, 200.0, Isotropic())])
    made = photograph_tissue(rig(150, camera_radii=camera_radii), stack, seed=2)
    samples = extract(made.images, made.camera, made.lights, made.sphere, variance=made.variance)
    mu_i, mu_o = np.cos(samples["theta_i"].to_numpy()), np.cos(samples["theta_o"].to_numpy())
    known = albedo / (4 * np.pi) * h_function(mu_i, albedo) * h_function(mu_o, albedo) / (mu_i + mu_o)
    value, error = samples["value"].to_numpy()[:, 0], samples["standard_error"].to_numpy()[:, 0]

    def ratio(which):
        total = (known * mu_i)[which].sum()
        return (value * mu_i)[which].sum() / total, np.sqrt((((error * mu_i)[which]) ** 2).sum()) / total

    whole, whole_se = ratio(slice(None))
    assert whole_se < 0.005
    assert abs(whole - 1) < 4 * whole_se + 0.005
    for low, high in ((0, 30), (30, 60), (60, 75)):
        for theta in ("theta_i", "theta_o"):
            degrees = np.degrees(samples[theta].to_numpy())
            part, se = ratio((degrees >= low) & (degrees < high))
            assert se < 0.012
            assert abs(part - 1) < 4 * se + 0.01


def test_layers_and_surface_agree_with_the_flat_sample():
    stack = plain_stack(
        [(1.35, 0.01, 50.0, 0.1, HenyeyGreenstein(0.9)), (1.38, 1.0, 20.0, 200.0, HenyeyGreenstein(0.8))]
    )
    made = photograph_tissue(rig(400), stack, seed=3)
    samples = extract(made.images, made.camera, made.lights, made.sphere, variance=made.variance)
    flat = goniometer(stack, np.radians([45.0]), samples=1_000_000, seed=4)
    sphere, known = sphere_cut(samples, "incidence"), flat_cut(flat, "incidence")
    here = np.isfinite(sphere.at_deg)
    value, error = at_angles(known, sphere.at_deg[here])
    both = np.hypot(sphere.error[:, here], error)
    z = (sphere.value[:, here] - value) / both
    assert here.sum() >= 8
    assert (z**2).mean() < 3.1  # χ² of 9 points exceeds 28 once in 1000 seeds
    level = np.sqrt((both**2).sum()) / value.sum()
    assert level < 0.03
    assert abs(sphere.value[:, here].sum() / value.sum() - 1) < 4 * level + 0.01


def test_a_small_sphere_loses_light_that_a_flat_sample_returns():
    stack = plain_stack([(1.0, 0.01, 1.0, 200.0, Isotropic())])
    levels = []
    for radius in (2.0, 400.0):
        small = SphereRig.make(
            arc(4, last_deg=100.0, distance_radii=math.inf, channels=1), radius_px=15, radius_mm=radius,
            silhouette="none", samples_per_pixel=200,
        )  # fmt: skip
        made = photograph_tissue(small, stack, seed=1)
        samples = extract(made.images, made.camera, made.lights, made.sphere, variance=made.variance)
        levels.append(float((samples["value"][:, 0] * np.cos(samples["theta_i"])).mean()))
    assert levels[0] < 0.8 * levels[1]


def test_turned_paths_keep_the_light_of_a_whole_sky():
    """Discs that tile a band of the sky collect together what the paths brought out through the band."""
    stack = plain_stack([(1.0, 1.0, 9.0, 200.0, Isotropic())])
    found = exits(stack, 40.0, 400.0, 50_000, seed=5)
    polar = np.arccos(found.direction[:, 2])
    left = found.weight[:, 0] > 0
    assert 0.3 < left.mean() <= 1
    assert np.linalg.norm(found.direction[left], axis=1) == pytest.approx(1.0, abs=1e-3)
    delta = 0.05
    angles = np.arange(0.5, 1.5, 0.02)
    radius = 20.0
    size = (51, 51)
    total = np.zeros(len(angles))
    for k, a in enumerate(angles):
        value, _ = pictures(found, [(float(a), 0.3)], delta, radius, (25.0, 25.0), size, seed=1)
        # Mean radiance over the disc of the outline, of a sky of 1 over the light's disc alone.
        total[k] = value.sum() / (np.pi * radius**2) * (np.pi * np.sin(delta) ** 2)
    per_steradian = total / (2 * np.pi * (1 - np.cos(delta)))
    band = float(np.sum(per_steradian * 2 * np.pi * np.sin(angles)) * 0.02)
    edges = (angles[0] - 0.01, angles[-1] + 0.01)
    known = found.weight[left & (polar > edges[0]) & (polar < edges[1]), 0].sum() / len(polar)
    assert band == pytest.approx(known, rel=0.03)


def test_pictures_of_one_light_share_out_the_paths_and_err_independently():
    stack = plain_stack([(1.0, 1.0, 9.0, 200.0, Isotropic())])
    collinear = replace(rig(200), lights=ring(4, angle_deg=0.0, distance_radii=math.inf, channels=1))
    made = photograph_tissue(collinear, stack, half_angle_deg=10.0, seed=6)
    images, variance = made.images.to_numpy()[..., 0], made.variance.to_numpy()[..., 0]
    both = (images[0] - images[1]) / np.sqrt(variance[0] + variance[1] + 1e-300)
    lit = variance[0] + variance[1] > 0
    assert 0.7 < both[lit].var() < 1.3
    level = images.sum((1, 2))
    error = np.sqrt(variance.sum((1, 2)))
    assert (np.abs(level - level.mean()) < 4 * error).all()


def test_repeats_and_seeds():
    stack = plain_stack([(1.4, 1.0, 9.0, 200.0, Isotropic())])
    first, again, other = (photograph_tissue(rig(5), stack, seed=s).images for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_redirections_without_an_axis_keep_the_reflectance():
    from livlab.model.tissue.stack import Interaction, OpticalStack, PlaneLayer

    one = np.ones(1)
    scatterer = Interaction("s", 5.0 * one, one, (Isotropic(),), "abs_cos")
    stack = OpticalStack(500 * one, (PlaneLayer("l", math.inf, 1.0 * one, (scatterer,)),), one, one)
    oriented, free = (goniometer(x, [0.6], samples=400_000, seed=2) for x in (stack, unoriented(stack)))
    error = math.hypot(float(oriented.reflectance_se[0, 0]), float(free.reflectance_se[0, 0]))
    assert abs(float(oriented.reflectance[0, 0] - free.reflectance[0, 0])) < 4 * error
    # Counted from one axis, the factor throws light into the plane of that axis.
    across = oriented.brdf[0, 0].sel(phi=np.pi / 2, method="nearest").sum()
    along = oriented.brdf[0, 0].isel(phi=-1).sum()
    assert float(along / across) > 1.5 * float(free.brdf[0, 0].isel(phi=-1).sum() / free.brdf[0, 0].isel(phi=3).sum())


def test_what_cannot_be_photographed_is_refused():
    stack = plain_stack([(1.4, 1.0, 9.0, 3.0, Isotropic()), (1.4, 1.0, 9.0, 50.0, Isotropic())])
    near = replace(rig(5), lights=arc(2))
    with pytest.raises(InputError, match="distant"):
        photograph_tissue(near, stack)
    with pytest.raises(InputError, match="past the sphere's centre"):
        photograph_tissue(moved(rig(5), np.array([1.0, 0.0, 0.0])), stack)
    tiny = SphereRig.make(arc(2, distance_radii=math.inf), radius_px=10, radius_mm=2.0, silhouette="none")
    with pytest.raises(InputError, match="reach 3 mm deep"):
        photograph_tissue(tiny, stack)
    with pytest.raises(InputError, match="half_angle_deg"):
        photograph_tissue(rig(5), stack, half_angle_deg=0.0)
