"""Finer triangles where they are wanted, without gaps to the coarser ones beside them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from livlab.model.shapes.mesh import TriangleMesh

Index = NDArray[np.int64]


def edges(mesh: TriangleMesh) -> tuple[Index, Index]:
    """Unique edges (e, 2) and, for each face, the numbers (m, 3) of its edges 0→1, 1→2 and 2→0."""
    size = np.int64(max(len(mesh.vertices), 1))
    start = mesh.faces.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    keys, inverse = np.unique(np.minimum(start, end) * size + np.maximum(start, end), return_inverse=True)
    return np.stack([keys // size, keys % size], axis=-1), inverse.reshape(-1, 3)


def without_flat(mesh: TriangleMesh, height_mm: float) -> TriangleMesh:
    """Swap the longest edge of each face lower than this for the other diagonal of the two faces beside it.

    Cutting leaves faces whose three corners lie on one line; the middle one then becomes a corner of the neighbour.

    >>> flat = TriangleMesh([[0, 0, 0], [2, 0, 0], [1, 0, 0], [1, -1, 0]], [[0, 1, 2], [1, 0, 3]])
    >>> without_flat(flat, 1e-9).face_areas.tolist()
    [0.5, 0.5]
    """
    faces = mesh.faces.astype(np.int64)
    for face in np.flatnonzero(mesh.face_heights < height_mm):
        corners = mesh.vertices[faces[face]]
        k = int(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).argmax())
        a, b, c = np.roll(faces[face], -k)
        beside = np.flatnonzero((faces == b).any(axis=1) & (faces == a).any(axis=1))
        beside = beside[beside != face]
        if len(beside) != 1:
            continue
        d = int(faces[beside[0]][~np.isin(faces[beside[0]], [a, b])][0])
        if d != c and not ((faces == c).any(axis=1) & (faces == d).any(axis=1)).any():  # that edge is still free
            faces[face], faces[beside[0]] = (a, d, c), (d, b, c)
    return TriangleMesh(mesh.vertices, faces)


def split(mesh: TriangleMesh, ends: Index, of_face: Index, chosen: NDArray[np.bool_]) -> TriangleMesh:
    """Put a vertex in the middle of each chosen edge and cut the faces beside it in two, three or four.

    The new vertices follow the old ones, in the order of the chosen edges.

    >>> from livlab.model.shapes import box
    >>> block = box(2.0)
    >>> ends, of_face = edges(block)
    >>> fine = split(block, ends, of_face, np.arange(len(ends)) % 2 == 0)
    >>> len(fine.vertices), len(fine.faces), round(fine.volume, 12)
    (17, 30, 8.0)
    """
    middle = np.full(len(ends), -1, dtype=np.int64)
    middle[chosen] = len(mesh.vertices) + np.arange(int(chosen.sum()))
    vertices = np.concatenate([mesh.vertices, mesh.vertices[ends[chosen]].mean(axis=1)])
    cut = chosen[of_face]
    count = cut.sum(axis=1)
    # Turn each face until the pattern is: one, the first edge; two, the first and the second.
    turn = np.where(count == 1, cut.argmax(axis=1), np.where(count == 2, (cut.argmin(axis=1) + 1) % 3, 0))
    order = (np.arange(3) + turn[:, None]) % 3
    v = np.take_along_axis(mesh.faces.astype(np.int64), order, 1)
    m = np.take_along_axis(middle[of_face], order, 1)
    whole, one, two, three = (count == k for k in range(4))
    pieces = [v[whole]]
    pieces += [np.stack(p, axis=-1)[one] for p in ((v[:, 0], m[:, 0], v[:, 2]), (m[:, 0], v[:, 1], v[:, 2]))]
    pieces += [
        np.stack(p, axis=-1)[two]
        for p in ((m[:, 0], v[:, 1], m[:, 1]), (v[:, 0], m[:, 0], m[:, 1]), (v[:, 0], m[:, 1], v[:, 2]))
    ]
    corners = [(v[:, k], m[:, k], m[:, (k + 2) % 3]) for k in range(3)]
    pieces += [np.stack(p, axis=-1)[three] for p in (*corners, (m[:, 0], m[:, 1], m[:, 2]))]
    return TriangleMesh(vertices, np.concatenate(pieces))
