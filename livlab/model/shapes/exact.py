"""Questions to libigl about triangle meshes: exact distances, winding numbers, intersections.

Only libigl's core (MPL 2.0) is used, none of its `copyleft` modules.
"""

from __future__ import annotations

from functools import cached_property
from weakref import WeakKeyDictionary

import igl  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.model.shapes.mesh import FloatArray, TriangleMesh

Pairs = NDArray[np.int64]

_DRAWN = 1e-6
_NEEDLE = 1e-5  # height of a face over the mesh's extent
_ON_BORDER = 1e-12  # barycentric coordinate below which a point counts as on that edge, as libigl has it


class _Asked:
    """A mesh as libigl wants it, with what it would otherwise work out anew for every question."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.vertices = mesh.vertices
        self.faces = mesh.faces.astype(np.int64)
        self.crossing: Pairs | None = None

    def nearest(self, points: FloatArray) -> tuple[FloatArray, Pairs, FloatArray]:
        """Distance of each point, the face nearest to it, the nearest point on that."""
        squared, face, place = self._tree.squared_distance(self.vertices, self.faces, points)
        return np.sqrt(np.asarray(squared, dtype=np.float64)), np.asarray(face), np.asarray(place)

    def inside(self, points: FloatArray, face: Pairs, place: FloatArray) -> NDArray[np.bool_]:
        """Whether each point lies behind the pseudonormal (Bærentzen & Aanæs 2005) at its nearest place."""
        of_face, of_vertex, of_edge, edge = self._normals
        a, b, c = (self.vertices[self.faces[face, k]] for k in range(3))
        one, other, here = b - a, c - a, place - a
        aa, ab, bb, ha, hb = (
            np.einsum("ij,ij->i", x, y)
            for x, y in ((one, one), (one, other), (other, other), (here, one), (here, other))
        )
        area = aa * bb - ab * ab
        v, w = (bb * ha - ab * hb) / area, (aa * hb - ab * ha) / area
        border = np.stack([1.0 - v - w, v, w], axis=-1) <= _ON_BORDER
        normal = of_face[face]
        for k in range(3):
            on_edge = border[:, k] & (border.sum(axis=1) == 1)
            normal[on_edge] = of_edge[edge[len(self.faces) * k + face[on_edge]]]
            at_vertex = ~border[:, k] & (border.sum(axis=1) == 2)
            normal[at_vertex] = of_vertex[self.faces[face[at_vertex], k]]
        return np.asarray(np.einsum("ij,ij->i", points - place, normal) < 0)

    @cached_property
    def _tree(self) -> igl.AABB:
        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    @cached_property
    def _normals(self) -> tuple[FloatArray, FloatArray, FloatArray, Pairs]:
        of_face = igl.per_face_normals(self.vertices, self.faces)
        of_vertex = igl.per_vertex_normals(
            self.vertices, self.faces, igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_ANGLE, of_face
        )
        of_edge, _, edge = igl.per_edge_normals(self.vertices, self.faces, igl.PER_EDGE_NORMALS_WEIGHTING_TYPE_UNIFORM)
        return of_face, of_vertex, of_edge, edge


_asked: WeakKeyDictionary[TriangleMesh, _Asked] = WeakKeyDictionary()


def _of(mesh: TriangleMesh) -> _Asked:
    made = _asked.get(mesh)
    if made is None:
        made = _asked[mesh] = _Asked(mesh)
    return made


def signed_distance(mesh: TriangleMesh, points_mm: ArrayLike) -> FloatArray:
    """Signed distance in mm of points (n, 3) to a closed mesh, positive inside.

    The sign is the pseudonormal's (Bærentzen & Aanæs 2005); on a mesh with needles, as cutting leaves them, that is
    noise, and the sign is that of the fast winding number w (Barill et al. 2018), at twice the time: inside where
    w > 1/2. The length is that of the way to the nearest point, always; libigl 2.6 itself scales it by 1 − 2w.
    """
    return _signed(mesh, _points(points_mm))[0]


def nearest(mesh: TriangleMesh, points_mm: ArrayLike) -> tuple[FloatArray, Pairs, FloatArray]:
    """Distance in mm of points (n, 3) to a mesh, the face nearest to each and the nearest point on it."""
    return _of(mesh).nearest(_points(points_mm))


def depth(mesh: TriangleMesh, points_mm: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Signed distance in mm of points (n, 3), positive inside, and the unit vectors along which it shrinks fastest."""
    points = _points(points_mm)
    deep, face, place = _signed(mesh, points)
    on_surface = np.abs(deep) < 1e-9
    outwards = (place - points) / np.where(on_surface, 1.0, deep)[:, None]
    return deep, np.where(on_surface[:, None], mesh.face_normals[face], outwards)


def winding_number(mesh: TriangleMesh, point_mm: ArrayLike) -> float:
    """How often the surface goes round a point: 1 inside a closed mesh that looks outwards, 0 outside."""
    return float(igl.winding_number(mesh.vertices, _of(mesh).faces, _points(point_mm))[0])


def self_intersections(mesh: TriangleMesh) -> Pairs:
    """Pairs (n, 2) of faces of one mesh that cross, by exact predicates."""
    import igl.predicates  # type: ignore[import-untyped]

    asked = _of(mesh)
    if asked.crossing is None:
        pairs = np.asarray(igl.predicates.find_self_intersections(mesh.vertices.copy(), asked.faces)[1])
        asked.crossing = pairs[[_cross(mesh, int(one), int(other)) for one, other in pairs]] if len(pairs) else pairs
        asked.crossing.setflags(write=False)
    return asked.crossing


def _cross(mesh: TriangleMesh, one: int, other: int) -> bool:
    """Whether two reported faces cross elsewhere than in the one vertex they share.

    On a flat cap the vertices lie off its plane by a rounding, and neighbours are reported for meeting in their vertex.
    Both are drawn back from it by a millionth.
    """
    shared = np.intersect1d(mesh.faces[one], mesh.faces[other])
    if len(shared) != 1:
        return True
    corners = []
    for face in (one, other):
        points = mesh.vertices[mesh.faces[face]].copy()
        at = mesh.faces[face] == shared[0]
        points[at] += _DRAWN * (points.mean(axis=0) - points[at])
        corners += list(points)
    return bool(igl.predicates.triangle_triangle_intersect(*corners)[0])


def intersections(one: TriangleMesh, other: TriangleMesh) -> Pairs:
    """Pairs (n, 2) of a face of one mesh and a face of the other that cross or touch, by exact predicates."""
    import igl.predicates

    found = igl.predicates.find_intersections(
        one.vertices.copy(), _of(one).faces, other.vertices.copy(), _of(other).faces
    )
    return np.asarray(found[1])


def split_vertices(mesh: TriangleMesh) -> NDArray[np.int64]:
    """Vertices at which two sheets of the surface touch."""
    return np.flatnonzero(~np.asarray(igl.is_vertex_manifold(_of(mesh).faces)))


def _signed(mesh: TriangleMesh, points: FloatArray) -> tuple[FloatArray, Pairs, FloatArray]:
    if len(points) == 0:
        return np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    asked = _of(mesh)
    distance, face, place = asked.nearest(points)
    if float(mesh.face_heights.min()) < _NEEDLE * float(mesh.extent.max()):
        inside = np.asarray(igl.fast_winding_number(mesh.vertices, asked.faces, points)) > 0.5
    else:
        inside = asked.inside(points, face, place)
    return np.where(inside, distance, -distance), face, place


def _points(points_mm: ArrayLike) -> FloatArray:
    return np.ascontiguousarray(points_mm, dtype=np.float64).reshape(-1, 3)
