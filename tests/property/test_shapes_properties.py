"""What holds for every box and sphere, however it is turned, moved and scaled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from livlab.model.shapes import Plane, box, check, distance_field, inset, section, sphere, wedge
from livlab.model.shapes.exact import signed_distance

lengths = st.floats(2.0, 40.0)
angles = st.tuples(*[st.floats(-np.pi, np.pi)] * 3)
places = st.tuples(*[st.floats(-100.0, 100.0)] * 3)


def moved(mesh, turn, place, scale=1.0, mirror=False):
    matrix = np.eye(4)
    matrix[:3, :3] = scale * Rotation.from_euler("xyz", turn).as_matrix()
    if mirror:
        matrix[:3, 0] *= -1
    matrix[:3, 3] = place
    return mesh.transformed(matrix), matrix


@given(
    size=st.tuples(lengths, lengths, lengths), turn=angles, place=places, scale=st.floats(0.5, 10), mirror=st.booleans()
)
def test_volume_and_area_follow_the_scale_and_nothing_else(size, turn, place, scale, mirror):
    mesh = box(size)
    other, _ = moved(mesh, turn, place, scale, mirror)
    assert other.volume == pytest.approx(scale**3 * np.prod(size), rel=1e-9)
    assert other.area == pytest.approx(scale**2 * mesh.area, rel=1e-9)
    assert check(other) == ()


@settings(max_examples=15)
@given(size=st.tuples(*[st.floats(6.0, 20.0)] * 3), turn=angles, place=places, seed=st.integers(0, 1000))
def test_the_field_has_the_right_sign_and_never_exceeds_the_distance(size, turn, place, seed):
    mesh, matrix = moved(box(size), turn, place)
    field = distance_field(mesh, 0.5, cached=False)
    local = np.random.default_rng(seed).uniform(-0.8, 0.8, (500, 3)) * size
    points = local @ matrix[:3, :3].T + matrix[:3, 3]
    beyond = np.abs(local) - np.asarray(size) / 2
    truth = -(np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0))
    assert signed_distance(mesh, points) == pytest.approx(truth, abs=1e-9)
    found = field.at(points)
    clear = np.abs(truth) > field.margin_mm
    assert (np.sign(found) == np.sign(truth))[clear].all()
    assert (np.abs(found) - field.margin_mm <= np.abs(truth) + 1e-6).all()
    inside_box = (truth > 0) & (truth < 1.0)
    assert (found[inside_box] <= truth[inside_box] + 1e-5).all()  # concave inside: interpolation errs to the safe side


@settings(max_examples=20)
@given(radius=st.floats(3.0, 30.0), place=places, depth=st.floats(0.001, 0.9))
def test_an_exact_distance_to_a_sphere_lies_between_its_facets_and_its_radius(radius, place, depth):
    mesh = sphere(radius, place, resolution_mm=radius / 8)
    sagitta = (radius / 8) ** 2 / (6 * radius)
    points = np.asarray(place) + (1 - depth) * (mesh.vertices[:20] - np.asarray(place))
    found = signed_distance(mesh, points)
    assert (found <= depth * radius + 1e-9).all()
    assert (found >= depth * radius - sagitta - 1e-9).all()


@settings(max_examples=25)
@given(size=st.tuples(lengths, lengths, lengths), turn=angles, share=st.floats(-0.8, 0.8), normal=angles)
def test_the_two_sides_of_a_cut_make_the_whole(size, turn, share, normal):
    mesh, _ = moved(box(size), turn, (1.0, 2.0, 3.0))
    direction = Rotation.from_euler("xyz", normal).as_matrix()[:, 0]
    reach = np.abs((mesh.vertices - [1.0, 2.0, 3.0]) @ direction).max()
    point = tuple(np.array([1.0, 2.0, 3.0]) + share * reach * direction)
    one = section(mesh, planes=Plane(point, tuple(direction)))
    other = section(mesh, planes=Plane(point, tuple(-direction)))
    assert one.outer.volume + other.outer.volume == pytest.approx(mesh.volume, rel=1e-9)
    assert one.removed_mm3 == pytest.approx(other.outer.volume, rel=1e-6)
    assert check(one.outer) == check(other.outer) == ()


@settings(max_examples=25)
@given(opening=st.floats(0.1, 3.0), turn=st.floats(-np.pi, np.pi))
def test_a_wedge_through_the_axis_of_a_ball_takes_its_share(opening, turn):
    mesh = sphere(10.0, resolution_mm=0.8)
    planes = wedge((0, 0, 0), (0, 0, 1), (np.cos(turn), np.sin(turn), 0.3), opening)
    assert section(mesh, planes=planes).removed_mm3 / mesh.volume == pytest.approx(opening / (2 * np.pi), abs=2e-3)


@settings(max_examples=8)
@given(radius=st.floats(5.0, 30.0), share=st.floats(0.005, 0.4), how=st.sampled_from(["distance", "normal", "scale"]))
def test_every_way_insets_a_sphere_by_the_thickness(radius, share, how):
    mesh = sphere(radius, resolution_mm=radius / 8)
    thickness = share * radius
    shell = inset(mesh, thickness, how, spacing_mm=radius / 15)
    assert shell.depth.median_mm == pytest.approx(thickness, rel=0.02)
    assert shell.depth.outside_share < 0.01
    assert 0 < shell.mesh.volume < mesh.volume
