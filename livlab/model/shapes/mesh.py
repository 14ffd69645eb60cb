"""Triangle meshes in mm: what every shape of livlab is in the end."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.errors import InputError

if TYPE_CHECKING:
    import trimesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A triangle mesh: vertices in mm and triples of vertex indices, counter-clockwise seen from outside.

    Parameters
    ----------
    vertices
        (n, 3) positions in mm.
    faces
        (m, 3) indices into `vertices`.

    Raises
    ------
    InputError
        An array has another shape, or an index points past the vertices. Anything subtler (holes, flipped faces,
        numbers that are not finite) is left to `livlab.model.shapes.check`.

    Examples
    --------
    >>> corner = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> corner.area, corner.face_normals.tolist()
    (0.5, [[0.0, 0.0, 1.0]])
    """

    vertices: FloatArray
    faces: IntArray

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        points = np.array(vertices, dtype=np.float64, order="C", ndmin=2)
        corners = np.array(faces, order="C", ndmin=2)
        points = points.reshape(0, 3) if points.size == 0 else points
        corners = corners.reshape(0, 3).astype(np.int32) if corners.size == 0 else corners
        if points.ndim != 2 or points.shape[1] != 3:
            raise InputError.of("vertices", points.shape, "must have the shape (n, 3)", "Give x, y, z of each vertex.")
        if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
            shown = f"{corners.dtype} {corners.shape}"
            raise InputError.of(
                "faces", shown, "must be integers of the shape (m, 3)", "Split polygons into triangles."
            )
        if corners.size and not 0 <= int(corners.min()) <= int(corners.max()) < len(points):
            place = int(np.argmax(((corners < 0) | (corners >= len(points))).any(axis=1)))
            bound = f"must lie in 0..{len(points) - 1}"
            raise InputError.of(f"faces[{place}]", corners[place].tolist(), bound, "Check the file's vertex count.")
        corners = np.ascontiguousarray(corners, dtype=np.int32)
        for array in (points, corners):
            array.setflags(write=False)
        object.__setattr__(self, "vertices", points)
        object.__setattr__(self, "faces", corners)

    def __repr__(self) -> str:
        return f"TriangleMesh({len(self.vertices)} vertices, {len(self.faces)} faces)"

    @cached_property
    def bounds(self) -> FloatArray:
        """Lowest and highest corner in mm, (2, 3)."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extent(self) -> FloatArray:
        """Size along x, y and z in mm."""
        return np.asarray(self.bounds[1] - self.bounds[0])

    @cached_property
    def _crosses(self) -> FloatArray:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def face_areas(self) -> FloatArray:
        """Area of each face in mm², (m,)."""
        return np.asarray(np.linalg.norm(self._crosses, axis=1) / 2)

    @cached_property
    def face_heights(self) -> FloatArray:
        """Shortest height of each face in mm, (m,): twice the area over the longest edge."""
        corners = self.vertices[self.faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        return np.asarray(2 * self.face_areas / np.maximum(longest, 1e-300))

    @property
    def area(self) -> float:
        """Area of the surface in mm²."""
        return float(self.face_areas.sum())

    @property
    def volume(self) -> float:
        """Enclosed volume in mm³ by the divergence theorem; negative when the faces look inwards."""
        centre = self.bounds.mean(axis=0)  # the sum loses digits far from the origin
        return float(np.einsum("ij,ij->", self.vertices[self.faces[:, 0]] - centre, self._crosses) / 6)

    @cached_property
    def face_normals(self) -> FloatArray:
        """Unit normal of each face, outwards, (m, 3); zero where the face has no area."""
        length = np.linalg.norm(self._crosses, axis=1, keepdims=True)
        return np.asarray(self._crosses / np.where(length > 0, length, 1.0))

    @cached_property
    def vertex_normals(self) -> FloatArray:
        """Unit normal of each vertex, (n, 3): the faces' normals weighted by their angles at the vertex.

        Thürmer & Wüthrich 1998; unlike an average weighted by area it does not depend on how the surface is cut
        into triangles. Zero at a vertex without faces.
        """
        total = np.zeros_like(self.vertices)
        for k in range(3):
            here = self.vertices[self.faces[:, k]]
            one = self.vertices[self.faces[:, (k + 1) % 3]] - here
            other = self.vertices[self.faces[:, (k + 2) % 3]] - here
            angle = np.arctan2(2 * self.face_areas, np.einsum("ij,ij->i", one, other))
            for axis in range(3):
                total[:, axis] += np.bincount(
                    self.faces[:, k], angle * self.face_normals[:, axis], minlength=len(total)
                )
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.asarray(total / np.where(length > 0, length, 1.0))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of vertices and faces: the identity of the mesh in caches and records."""
        hashed = hashlib.sha256(f"TriangleMesh {self.vertices.shape} {self.faces.shape}".encode())
        hashed.update(self.vertices.astype("<f8").tobytes())
        hashed.update(self.faces.astype("<i4").tobytes())
        return hashed.hexdigest()

    def transformed(self, matrix: ArrayLike) -> TriangleMesh:
        """Map the vertices by a 4×4 affine matrix; a mirroring one turns the faces, so that they still look outwards.

        >>> from livlab.model.shapes import box
        >>> mirrored = box((1, 2, 3)).transformed([[-1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> round(mirrored.volume, 12)
        6.0
        """
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (4, 4) or not np.isfinite(m).all() or not np.array_equal(m[3], [0, 0, 0, 1]):
            raise InputError.of("matrix", m.shape, "must be a finite affine 4×4 matrix", "Last row 0 0 0 1.")
        determinant = float(np.linalg.det(m[:3, :3]))
        if determinant == 0:
            raise InputError.of("matrix", "determinant 0", "must not flatten the mesh", "Check its columns.")
        faces = self.faces if determinant > 0 else self.faces[:, ::-1]
        return TriangleMesh(self.vertices @ m[:3, :3].T + m[:3, 3], faces)

    def scaled(self, factor: float) -> TriangleMesh:
        """Multiply all lengths by a positive factor, about the origin."""
        if not (np.isfinite(factor) and factor > 0):
            raise InputError.of("factor", factor, "must be > 0", "Give a positive number.")
        return TriangleMesh(self.vertices * factor, self.faces)

    def moved(self, by_mm: ArrayLike) -> TriangleMesh:
        """Shift by a vector in mm."""
        return TriangleMesh(self.vertices + np.asarray(by_mm, dtype=np.float64), self.faces)

    def flipped(self) -> TriangleMesh:
        """Turn every face over."""
        return TriangleMesh(self.vertices, self.faces[:, ::-1])

    def as_trimesh(self) -> trimesh.Trimesh:
        """Copy into trimesh's type, nothing merged and nothing removed."""
        import trimesh

        return trimesh.Trimesh(vertices=self.vertices.copy(), faces=self.faces.astype(np.int64), process=False)
