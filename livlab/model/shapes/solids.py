"""Solids of manifold3d: what cuts, joins and thins meshes and leaves them closed."""

from __future__ import annotations

import manifold3d  # type: ignore[import-not-found]
import numpy as np

from livlab.errors import InputError
from livlab.model.shapes.mesh import TriangleMesh

_REMEDIES = {"NotManifold": "holes, flipped faces or edges of three faces", "NonFiniteVertex": "NaN or infinity"}


def solid(mesh: TriangleMesh, name: str = "mesh") -> manifold3d.Manifold:
    """Copy a closed mesh into a solid."""
    made = manifold3d.Manifold(
        manifold3d.Mesh64(vert_properties=mesh.vertices.copy(), tri_verts=mesh.faces.astype(np.uint64))
    )
    status = made.status().name
    if status != "NoError" or (made.is_empty() and len(mesh.faces)):
        reason = _REMEDIES.get(status, status)
        raise InputError.of(name, reason, "must be a closed solid", "Run `check` on it: it names the place.")
    return made


def mesh_of(made: manifold3d.Manifold) -> TriangleMesh:
    """Surface of a solid; no faces if it is empty."""
    if made.is_empty():
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    out = made.to_mesh64()
    return TriangleMesh(np.asarray(out.vert_properties)[:, :3], np.asarray(out.tri_verts).astype(np.int64))


def thinned(mesh: TriangleMesh, faces: int) -> tuple[TriangleMesh, float]:
    """Fewer faces: edges shorter than a tolerance are collapsed, and the tolerance searched by halving.

    Returns
    -------
    mesh, tolerance_mm
        At most `faces` faces and, where it can be had, more than nine tenths of that; the surface moved by no more
        than the tolerance.
    """
    if faces < 100:
        raise InputError.of("faces", faces, "must be at least 100", "A closed organ needs some hundred faces.")
    if len(mesh.faces) <= faces:
        return mesh, 0.0
    whole = solid(mesh)
    low, high = 0.0, float(mesh.extent.max()) / 20
    best, used = whole.simplify(high), high
    if best.num_tri() > faces or best.is_empty():
        raise InputError.of("faces", faces, f"simplifying ends at {best.num_tri()} faces", "Allow more faces.")
    for _ in range(16):
        middle = (low + high) / 2 if low else high / 4
        tried = whole.simplify(middle)
        if tried.num_tri() <= faces:
            best, used, high = tried, middle, middle
            if tried.num_tri() > 0.9 * faces:
                break
        else:
            low = middle
    return mesh_of(best), used
