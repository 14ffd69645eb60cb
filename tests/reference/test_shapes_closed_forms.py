"""Sphere, box and liver against what is known of them in closed form."""

import numpy as np
import pytest

from livlab.model.shapes import Plane, TriangleMesh, box, check, distance_field, liver, section, sphere
from livlab.model.shapes.exact import depth, nearest, signed_distance


def box_distance(points, size):
    """Signed distance to a box about the origin, positive inside."""
    beyond = np.abs(points) - np.asarray(size) / 2
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    return -(outside + np.minimum(beyond.max(axis=-1), 0))


@pytest.fixture(scope="module")
def ball():
    mesh = sphere(20.0, (3.0, -4.0, 5.0), resolution_mm=0.5)
    return mesh, distance_field(mesh, 0.5, cached=False)


@pytest.fixture(scope="module")
def organ():
    return liver(resolution_mm=1.5, cached=False)


def test_a_sphere_comes_closer_to_its_volume_and_area_with_the_square_of_the_edge():
    missing = []
    for edge in (2.0, 1.0):
        mesh = sphere(10.0, resolution_mm=edge)
        missing.append((1 - mesh.volume / (4 / 3 * np.pi * 1000), 1 - mesh.area / (4 * np.pi * 100)))
    (coarse_volume, coarse_area), (fine_volume, fine_area) = missing
    assert 0 < fine_area < fine_volume < 3 / 8 * 0.1**2  # mean sagitta edge²/(8 R) of an even-sided face
    assert coarse_volume / fine_volume == pytest.approx(4, rel=0.15)
    assert coarse_area / fine_area == pytest.approx(4, rel=0.15)


def test_a_spheres_vertices_lie_on_it_and_its_normals_point_outwards():
    mesh = sphere(7.0, (1.0, 2.0, 3.0))
    away = mesh.vertices - [1.0, 2.0, 3.0]
    assert np.linalg.norm(away, axis=1) == pytest.approx(7.0, abs=1e-12)
    assert np.einsum("ij,ij->i", mesh.vertex_normals, away / 7.0).min() > 1 - 1e-6


def test_the_field_of_a_box_is_the_closed_form_near_its_surface():
    size = (12.0, 9.0, 7.0)
    field = distance_field(box(size), 0.5, cached=False)
    k, j, i = np.indices(field.values.shape).reshape(3, -1)
    truth = box_distance(field.origin_mm + 0.5 * np.stack([i, j, k], axis=-1), size)
    values = field.values.reshape(-1).astype(float)
    near = np.abs(truth) <= field.band_mm
    assert near.sum() > 5000
    assert np.abs(values - truth)[near].max() < 2e-6
    assert np.sign(values[np.abs(truth) > 1e-6]).tolist() == np.sign(truth[np.abs(truth) > 1e-6]).tolist()
    assert (np.abs(values) - np.abs(truth)).max() < 2e-6


def test_the_field_is_a_lower_bound_far_away_and_not_a_useless_one(ball):
    _, field = ball
    k, j, i = np.indices(field.values.shape).reshape(3, -1)
    nodes = field.origin_mm + 0.5 * np.stack([i, j, k], axis=-1)
    radius = np.linalg.norm(nodes - [3.0, -4.0, 5.0], axis=1)
    deep = 20.0 - radius > field.band_mm + 0.01
    values = field.values.reshape(-1)[deep].astype(float)
    loss = (20.0 - radius)[deep] - values
    assert deep.sum() > 100_000
    assert values.min() >= field.band_mm
    assert loss.min() > 0
    assert loss.max() < (np.sqrt(3) + 1 / np.sqrt(3)) * 0.5 + 0.01  # two nodes, the lattice and the facets


def test_a_capsule_a_tenth_of_a_millimetre_deep_is_right_to_a_micrometre_on_a_smooth_organ():
    """Curvature of a liver's dome: radius 50 mm; facets and grid as a liver has them by default."""
    whole = sphere(50.0, resolution_mm=0.75)
    mesh = section(whole, planes=Plane((0, 0, 46.0), (0, 0, -1))).outer
    field = distance_field(mesh, 0.5, cached=False)
    cap = mesh.faces[(mesh.vertices[mesh.faces].mean(axis=1)[:, 2] > 47.6)]
    assert len(cap) > 2000
    draw = np.random.default_rng(1)
    corners = mesh.vertices[cap[draw.integers(len(cap), size=4000)]]
    points = np.einsum("fk,fkd->fd", draw.dirichlet([1.0, 1.0, 1.0], size=4000), corners)
    points *= ((np.linalg.norm(points, axis=1) - 0.1) / np.linalg.norm(points, axis=1))[:, None]
    error = field.at(points) - signed_distance(mesh, points)
    assert np.median(np.abs(error)) < 1.0e-3
    assert np.abs(error).max() < 3.5e-3
    curvature = 0.5**2 / 8 * (2 / 50)  # spacing²/8 times the summed curvatures, two thirds of it on average
    assert error.mean() == pytest.approx(-curvature * 2 / 3, rel=0.4)


def test_a_cut_ball_has_the_distances_of_its_nearest_points():
    """Cuts leave needles, where the sign is the winding number's; the length is not."""
    cuts = [Plane((0, 0, 5.0), (0, 0, -1)), Plane((3.3, 0, 0), (-1, 0.1, 0.02))]
    mesh = section(sphere(20.0, resolution_mm=1.0), planes=cuts).outer
    assert mesh.face_heights.min() < 1e-5 * mesh.extent.max()
    points = np.random.default_rng(1).uniform(-25, 25, (4000, 3))
    deep, ways = depth(mesh, points)
    assert np.abs(deep) == pytest.approx(nearest(mesh, points)[0], rel=1e-12)
    assert np.linalg.norm(ways, axis=1) == pytest.approx(np.ones(4000), abs=1e-9)
    assert signed_distance(mesh, points).tolist() == deep.tolist()
    # What both planes' normals look at is cut away.
    gone = (points[:, 2] < 5.0) & ((points - [3.3, 0, 0]) @ [-1, 0.1, 0.02] > 0)
    held = ~gone & (np.linalg.norm(points, axis=1) < 20.0)
    clear = np.abs(deep) > 0.02  # facets of a millimetre lie up to 6 µm within the ball, cuts are exact
    assert (deep > 0)[clear].tolist() == held[clear].tolist()


def test_beyond_the_grid_the_modulus_is_a_lower_bound(ball):
    _, field = ball
    points = np.array([[60.0, 0.0, 0.0], [3.0, -4.0, 90.0], [-80.0, -80.0, 70.0]])
    truth = np.linalg.norm(points - [3.0, -4.0, 5.0], axis=1) - 20.0
    values = field.at(points)
    assert (values < 0).all()
    assert (-values <= truth + 1e-9).all()
    assert (-values > 0.8 * truth).all()


def test_the_liver_is_a_sound_solid_of_an_organs_proportions(organ):
    assert check(organ) == ()
    assert organ.extent[0] == pytest.approx(140.0, abs=1e-9)
    assert 70 < organ.extent[1] < 95
    assert 80 < organ.extent[2] < 105
    # A liver of 1500 ml is about 21 cm wide; at two thirds of the width it has 8/27 of the volume.
    assert 230_000 < organ.volume < 450_000


def test_the_livers_right_lobe_is_the_larger_and_its_left_lobe_tapers(organ):
    centres = organ.vertices[organ.faces].mean(axis=1)
    heights = []
    for x in (-40.0, 40.0, 60.0):
        slab = organ.vertices[np.abs(organ.vertices[:, 0] - x) < 2]
        heights.append(float(np.ptp(slab[:, 2])))
    assert heights[0] > 1.8 * heights[1] > 1.8 * heights[2]
    upward = organ.face_normals[:, 2] > 0.9
    assert centres[upward][:, 2].mean() > 20  # the dome


def test_the_livers_visceral_side_is_hollow(organ):
    """Its hull holds a good deal more, and what is missing lies below and behind."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(organ.vertices)
    assert 1.1 < hull.volume / organ.volume < 1.6


@pytest.mark.slow
def test_the_livers_margin_is_thin_and_nowhere_thinner_than_about_two_millimetres():
    """What a ball cannot reach from inside: of radius 1 mm at most a third of a millimetre, of 2.5 mm the margin.

    The surface at the ball's radius is where its centre may be; a place on the outer surface farther from that than
    the radius is out of its reach.
    """
    from skimage.measure import marching_cubes

    organ = liver(resolution_mm=1.0, cached=False)
    field = distance_field(organ, 0.5, band_mm=3.2, cached=False)
    beyond = []
    for radius in (1.0, 2.5):
        found = marching_cubes(field.values, radius, spacing=(0.5,) * 3)
        centres = TriangleMesh(np.asarray(found[0], dtype=float)[:, ::-1] + field.origin_mm, found[1])
        beyond.append(nearest(centres, organ.vertices)[0] - radius)
    assert beyond[0].max() < 0.34
    margin = organ.vertices[beyond[1] > 0.5]
    assert len(margin) > 200
    assert np.ptp(margin[:, 0]) > 60  # all along the front
    assert np.median(margin[:, 2]) < -15


def test_the_liver_scales():
    small = liver(70.0, resolution_mm=2.0, cached=False)
    large = liver(140.0, resolution_mm=2.0, cached=False)
    assert large.volume == pytest.approx(8 * small.volume, rel=1e-12)
