"""Sharp edges for renderers that shade between vertex normals."""

from __future__ import annotations

import numpy as np

from livlab.errors import InputError
from livlab.model.shapes.mesh import TriangleMesh
from livlab.model.shapes.refine import edges


def creased(mesh: TriangleMesh, angle: float = np.pi / 6) -> TriangleMesh:
    """Give each side of a sharp edge its own vertices, so that `vertex_normals` do not bend round it.

    For shading only: by index the surface is open along its creases, though not by place. A flat cap keeps the cut's
    normal this way.

    Parameters
    ----------
    mesh
        Closed mesh; a section, say.
    angle
        Edges whose faces' normals differ by more are creases, in radians.

    Examples
    --------
    >>> from livlab.model.shapes import box
    >>> block = creased(box(2.0))
    >>> len(block.vertices), np.unique(np.abs(block.vertex_normals)).tolist()
    (24, [0.0, 1.0])
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not 0 < angle < np.pi:
        raise InputError.of("angle", angle, "must lie between 0 and π", "Take π/6.")
    count = len(mesh.faces)
    ends, of_face = edges(mesh)
    order = np.argsort(of_face.reshape(-1), kind="stable")
    held = of_face.reshape(-1)[order]
    twice = np.flatnonzero(held[1:] == held[:-1])
    one, other = order[twice], order[twice + 1]  # face * 3 + edge: two faces beside one edge
    normals = mesh.face_normals
    smooth = np.einsum("ij,ij->i", normals[one // 3], normals[other // 3]) >= np.cos(angle)
    one, other = one[smooth], other[smooth]
    # Corner k of face f is number 3 f + k; edge k runs from corner k to corner k + 1.
    links = []
    for end in range(2):
        vertex = ends[of_face.reshape(-1)[one], end]
        links.append([3 * (e // 3) + (mesh.faces[e // 3] == vertex[:, None]).argmax(axis=1) for e in (one, other)])
    start, stop = np.concatenate([a for a, _ in links]), np.concatenate([b for _, b in links])
    graph = coo_matrix((np.ones(len(start), dtype=np.int8), (start, stop)), shape=(3 * count, 3 * count))
    total, label = connected_components(graph, directed=False)
    vertices = np.zeros((total, 3))
    vertices[label] = mesh.vertices[mesh.faces.reshape(-1)]
    return TriangleMesh(vertices, label.reshape(-1, 3))
