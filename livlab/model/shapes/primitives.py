"""Box and sphere: shapes whose volume, area and distance are known in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.errors import InputError
from livlab.model.shapes.mesh import TriangleMesh

_BOX_FACES = [
    *([0, 2, 1], [1, 2, 3]),  # z low
    *([4, 5, 6], [5, 7, 6]),  # z high
    *([0, 1, 4], [1, 5, 4]),  # y low
    *([2, 6, 3], [3, 6, 7]),  # y high
    *([0, 4, 2], [2, 4, 6]),  # x low
    *([1, 3, 5], [3, 7, 5]),  # x high
]

_MAX_SPHERE_FACES = 20_000_000


def box(size_mm: ArrayLike, centre_mm: ArrayLike = (0.0, 0.0, 0.0)) -> TriangleMesh:
    """Axis-aligned box of twelve triangles.

    Parameters
    ----------
    size_mm
        Edge lengths along x, y and z, or one for a cube.
    centre_mm
        Its centre.

    Examples
    --------
    >>> block = box((10, 20, 5))
    >>> block.volume, block.area
    (1000.0, 700.0)
    """
    size = np.broadcast_to(np.asarray(size_mm, dtype=np.float64), (3,))
    if not (np.isfinite(size).all() and (size > 0).all()):
        raise InputError.of("size_mm", size.tolist(), "must be > 0", "Give positive lengths in mm.")
    corners = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    return TriangleMesh(corners * size + np.asarray(centre_mm, dtype=np.float64), _BOX_FACES)


def sphere(
    radius_mm: float, centre_mm: ArrayLike = (0.0, 0.0, 0.0), *, resolution_mm: float | None = None
) -> TriangleMesh:
    """Sphere from an icosahedron, each face cut into k² and pushed out to the radius.

    Parameters
    ----------
    radius_mm
        Distance of every vertex from the centre; the faces' middles lie `resolution_mm`² / (6 `radius_mm`) or less
        inside the true sphere.
    centre_mm
        Its centre.
    resolution_mm
        Longest edge; a twentieth of the radius unless said.

    Examples
    --------
    >>> ball = sphere(10.0)
    >>> round(ball.volume / (4 / 3 * np.pi * 10**3), 2), round(ball.area / (4 * np.pi * 10**2), 2)
    (1.0, 1.0)
    """
    if not (np.isfinite(radius_mm) and radius_mm > 0):
        raise InputError.of("radius_mm", radius_mm, "must be > 0", "Give a positive length in mm.")
    longest = radius_mm / 20 if resolution_mm is None else resolution_mm
    if not (np.isfinite(longest) and longest > 0):
        raise InputError.of("resolution_mm", resolution_mm, "must be > 0", "Give a positive length in mm.")
    # Pushing out stretches an edge in the middle of a face most, by less than 1.26.
    parts = int(np.ceil(1.0515 * 1.26 * radius_mm / longest))
    if 20 * parts**2 > _MAX_SPHERE_FACES:
        bound = f"would make {20 * parts**2 / 1e6:.3g} million faces"
        raise InputError.of("resolution_mm", resolution_mm, bound, "Ask for longer edges.")
    vertices, faces = _icosahedron()
    points, triangles = _cut(vertices, faces, parts)
    points *= radius_mm / np.linalg.norm(points, axis=1, keepdims=True)
    return TriangleMesh(points + np.asarray(centre_mm, dtype=np.float64), triangles)


def _icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    import trimesh

    made = trimesh.creation.icosahedron()
    return np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int64)


def _cut(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], parts: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Cut each face into parts² by a triangular lattice; vertices on shared edges are merged."""
    rows = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    index = {key: n for n, key in enumerate(rows)}
    weights = np.array([(parts - i - j, i, j) for i, j in rows])
    small = [[index[i, j], index[i + 1, j], index[i, j + 1]] for i in range(parts) for j in range(parts - i)]
    small += [
        [index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]] for i in range(parts) for j in range(parts - i - 1)
    ]
    # A lattice point is known by the whole-number weights of the icosahedron's vertices: merging is exact.
    corner = np.broadcast_to(faces[:, None, :], (len(faces), len(rows), 3)).reshape(-1, 3)
    weight = np.broadcast_to(weights, (len(faces), len(rows), 3)).reshape(-1, 3)
    corner = np.where(weight > 0, corner, -1)
    order = np.argsort(corner, axis=1)
    key = np.concatenate([np.take_along_axis(corner, order, 1), np.take_along_axis(weight, order, 1)], axis=1)
    unique, inverse = np.unique(key, axis=0, return_inverse=True)
    points = np.einsum("nk,nkd->nd", unique[:, 3:] / parts, vertices[unique[:, :3]])
    triangles = inverse.reshape(len(faces), len(rows))[:, np.array(small)].reshape(-1, 3)
    return points, triangles
