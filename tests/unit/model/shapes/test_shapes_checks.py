"""Each bad mesh is refused, with the place and a remedy; what is only odd is told."""

import numpy as np
import pytest

from livlab.errors import InputError
from livlab.model.shapes import TriangleMesh, box, check, sphere


def with_vertex(mesh, index, value):
    vertices = mesh.vertices.copy()
    vertices[index] = value
    return TriangleMesh(vertices, mesh.faces)


def joined(*meshes):
    offsets = np.cumsum([0, *[len(m.vertices) for m in meshes[:-1]]])
    faces = [m.faces + o for m, o in zip(meshes, offsets, strict=True)]
    return TriangleMesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def refused(mesh, inner=None, **options):
    with pytest.raises(InputError) as caught:
        check(mesh, inner, **options)
    assert caught.value.remedy
    return caught.value.message


BALL = sphere(10.0, resolution_mm=2.0)
CUBE = box(10.0)


def test_sound_meshes_pass():
    assert check(BALL) == ()
    assert check(BALL, BALL.scaled(0.9)) == ()


def test_a_hole_is_named_by_face_and_place():
    message = refused(TriangleMesh(BALL.vertices, np.delete(BALL.faces, 17, axis=0)))
    assert "3 open edges" in message
    face = int(message.split("of face ")[1].split()[0])
    assert set(BALL.faces[17]) & set(np.delete(BALL.faces, 17, axis=0)[face])
    place = np.array([float(x) for x in message.split("(")[1].split(")")[0].split(",")])
    assert np.linalg.norm(place - BALL.vertices[BALL.faces[17]].mean(axis=0)) < 1.5


def test_one_turned_face_and_all_of_them():
    faces = BALL.faces.copy()
    faces[5] = faces[5, ::-1]
    assert "run the same way" in refused(TriangleMesh(BALL.vertices, faces))
    assert "must look outwards" in refused(BALL.flipped())


def test_an_inner_wall_is_an_edge_of_three_faces():
    assert "three faces or more" in refused(TriangleMesh(CUBE.vertices, [*CUBE.faces.tolist(), [0, 1, 7]]))


def test_two_sheets_in_one_vertex():
    other = box(10.0, (10.0, 10.0, 10.0))  # corner 0 of this is corner 7 of the cube
    both = joined(CUBE, other)
    faces = both.faces.copy()
    faces[faces == 8] = 7
    message = refused(TriangleMesh(both.vertices, faces))
    assert "vertex 7" in message
    assert "(5, 5, 5)" in message


def test_faces_that_cross():
    message = refused(joined(CUBE, box((2.0, 2.0, 30.0))))
    assert "pairs of faces cross" in message
    assert "must not cross itself" in message


def test_a_vertex_pushed_through_the_other_side():
    top = int(np.argmax(BALL.vertices[:, 2]))
    assert "cross" in refused(with_vertex(BALL, top, [0, 0, -12.0]))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite(bad):
    message = refused(with_vertex(CUBE, 3, [1.0, bad, 0.0]))
    assert "vertex 3" in message
    assert "finite" in message


def test_faces_without_area():
    repeated = CUBE.faces.copy()
    repeated[4, 1] = repeated[4, 0]
    assert "face 4" in refused(TriangleMesh(CUBE.vertices, repeated))
    message = refused(with_vertex(CUBE, 0, CUBE.vertices[1]))
    assert "without area" in message


def test_empty_meshes_and_too_many_faces():
    assert "empty" in refused(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=int)))
    assert "at most 11" in refused(CUBE, max_faces=11)


def test_an_inner_mesh_that_pierces_the_outer():
    message = refused(BALL, BALL.scaled(0.9).moved((1.5, 0, 0)))
    assert "must not pierce" in message
    place = np.array([float(x) for x in message.split("(")[1].split(")")[0].split(",")])
    assert 6 < place[0] < 8  # the circle in which the spheres meet lies at 7.1


def test_an_inner_mesh_beside_the_outer():
    assert "outside" in refused(BALL, BALL.moved((40.0, 0, 0)))


def test_a_second_part_of_the_inner_mesh_beside_the_outer():
    assert "outside" in refused(BALL, joined(BALL.scaled(0.5), box(1.0, (30.0, 0, 0))))


def test_separate_parts_are_told():
    (said,) = check(joined(BALL, box(3.0, (40.0, 0, 0))))
    assert "2 separate components" in said
    assert "12 faces" in said


@pytest.mark.parametrize(("factor", "unit"), [(0.007, " m "), (7000.0, " um ")])
def test_the_likely_unit_of_an_organ(factor, unit):
    (said,) = check(BALL.scaled(factor))
    assert unit in said
    assert "139.5 mm" in said


@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "shape (n, 3)"),
        (np.eye(3), [[0, 1, 3]], "0..2"),
        (np.eye(3), [[0, 1, -1]], "faces[0]"),
        (np.eye(3), [[0.0, 1.0, 2.0]], "integers"),
        (np.eye(3), [[0, 1, 2, 0]], "(m, 3)"),
    ],
)
def test_arrays_that_are_no_mesh(vertices, faces, said):
    with pytest.raises(InputError) as caught:
        TriangleMesh(vertices, faces)
    assert said in caught.value.message


@pytest.mark.parametrize("call", [lambda: box(0.0), lambda: box((1, -1, 1)), lambda: sphere(-1.0)])
def test_lengths_that_are_not_positive(call):
    with pytest.raises(InputError):
        call()


def test_a_sphere_of_too_many_faces():
    with pytest.raises(InputError, match="million faces"):
        sphere(100.0, resolution_mm=0.01)
