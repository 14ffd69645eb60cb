"""Questions to libigl about triangle meshes: exact distances, winding numbers, intersections.

Only libigl's core (MPL 2.0) is used, none of its `copyleft` modules.
"""

from __future__ import annotations

import igl  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.model.shapes.mesh import FloatArray, TriangleMesh

Pairs = NDArray[np.int64]

_DRAWN = 1e-6
_NEEDLE = 1e-5  # height of a face over the mesh's extent


def signed_distance(mesh: TriangleMesh, points_mm: ArrayLike) -> FloatArray:
    """Signed distance in mm of points (n, 3) to a closed mesh, positive inside.

    The sign is the pseudonormal's (Bærentzen & Aanæs 2005); on a mesh with needles, as cutting leaves them, that is
    noise, and the sign is that of the fast winding number w (Barill et al. 2018), at twice the time: inside where
    w > 1/2. The length is that of the way to the nearest point, always; libigl 2.6 itself scales it by 1 − 2w.
    """
    return _signed(mesh, _points(points_mm))[0]


def nearest(mesh: TriangleMesh, points_mm: ArrayLike) -> tuple[FloatArray, Pairs, FloatArray]:
    """Distance in mm of points (n, 3) to a mesh, the face nearest to each and the nearest point on it."""
    squared, faces, places = igl.point_mesh_squared_distance(_points(points_mm), mesh.vertices, _faces(mesh))
    return np.sqrt(np.asarray(squared, dtype=np.float64)), np.asarray(faces), np.asarray(places)


def depth(mesh: TriangleMesh, points_mm: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Signed distance in mm of points (n, 3), positive inside, and the unit vectors along which it shrinks fastest."""
    points = _points(points_mm)
    deep, face, place = _signed(mesh, points)
    on_surface = np.abs(deep) < 1e-9
    outwards = (place - points) / np.where(on_surface, 1.0, deep)[:, None]
    return deep, np.where(on_surface[:, None], mesh.face_normals[face], outwards)


def winding_number(mesh: TriangleMesh, point_mm: ArrayLike) -> float:
    """How often the surface goes round a point: 1 inside a closed mesh that looks outwards, 0 outside."""
    return float(igl.winding_number(mesh.vertices, _faces(mesh), _points(point_mm))[0])


def self_intersections(mesh: TriangleMesh) -> Pairs:
    """Pairs (n, 2) of faces of one mesh that cross, by exact predicates."""
    import igl.predicates  # type: ignore[import-untyped]

    pairs = np.asarray(igl.predicates.find_self_intersections(mesh.vertices.copy(), _faces(mesh))[1])
    return pairs[[_cross(mesh, int(one), int(other)) for one, other in pairs]] if len(pairs) else pairs


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

    found = igl.predicates.find_intersections(one.vertices.copy(), _faces(one), other.vertices.copy(), _faces(other))
    return np.asarray(found[1])


def split_vertices(mesh: TriangleMesh) -> NDArray[np.int64]:
    """Vertices at which two sheets of the surface touch."""
    return np.flatnonzero(~np.asarray(igl.is_vertex_manifold(_faces(mesh))))


def _signed(mesh: TriangleMesh, points: FloatArray) -> tuple[FloatArray, Pairs, FloatArray]:
    if len(points) == 0:
        return np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    if float(mesh.face_heights.min()) < _NEEDLE * float(mesh.extent.max()):
        distance, faces, places = nearest(mesh, points)
        inside = np.asarray(igl.fast_winding_number(mesh.vertices, _faces(mesh), points)) > 0.5
        return np.where(inside, distance, -distance), faces, places
    found = igl.signed_distance(points, mesh.vertices, _faces(mesh), igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)
    return -np.asarray(found[0], dtype=np.float64), np.asarray(found[1]), np.asarray(found[2])


def _faces(mesh: TriangleMesh) -> NDArray[np.int64]:
    return mesh.faces.astype(np.int64)


def _points(points_mm: ArrayLike) -> FloatArray:
    return np.ascontiguousarray(points_mm, dtype=np.float64).reshape(-1, 3)
