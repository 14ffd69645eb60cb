"""What a mesh must be before light may walk in it; each refusal names the place and a remedy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.shapes.mesh import TriangleMesh

MAX_FACES = 5_000_000
"""A file with more is refused before it is read."""

_REPAIR = "Repair it in Blender, MeshLab or 3D Slicer, or mesh the segmentation with `livlab mesh`."
_FLAT = 1e-12  # of the largest extent: a lower face has no normal in double precision


def check(mesh: TriangleMesh, inner: TriangleMesh | None = None, *, max_faces: int = MAX_FACES) -> tuple[str, ...]:
    """Refuse a mesh that does not bound a solid, and an inner one that does not lie within it.

    Parameters
    ----------
    mesh
        Outer surface.
    inner
        Surface that should lie wholly inside, as the parenchyma does in the capsule.
    max_faces
        More are refused.

    Returns
    -------
    warnings
        What is allowed and yet odd: several components, a size that no organ has.

    Raises
    ------
    InputError
        Empty; numbers that are not finite; too many faces; faces without area; holes; edges of more than two faces;
        faces turned against their neighbours or all inwards; sheets that touch in a vertex; faces that cross; an inner
        surface that crosses the outer or lies outside it. The message names face or vertex and coordinates in mm.

    Examples
    --------
    >>> from livlab.model.shapes import box
    >>> check(box(10.0), box(9.8))
    ()
    >>> check(TriangleMesh(box(10.0).vertices, box(10.0).faces[1:]))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    livlab.errors.InputError: mesh: 3 open edges, one of face 0 at (0, 0, -5) mm: must be closed. Close the hole. ...
    """
    warnings = [*_one(mesh, "mesh", max_faces)]
    if inner is not None:
        warnings += check_inner(mesh, inner, max_faces=max_faces)
    return tuple(warnings)


def check_inner(outer: TriangleMesh, inner: TriangleMesh, *, max_faces: int = MAX_FACES) -> tuple[str, ...]:
    """As `check` of both, where the outer one has passed already."""
    warnings = tuple(f"inner mesh: {said}" for said in _one(inner, "inner mesh", max_faces))
    _nested(outer, inner)
    return warnings


def refuse_too_many(faces: int, max_faces: int = MAX_FACES) -> None:
    """Refuse a number of faces before any is read."""
    if faces > max_faces:
        raise InputError.of(
            "faces",
            faces,
            f"must be at most {max_faces}",
            "Decimate the mesh first (MeshLab, Blender), or mesh the segmentation at a coarser spacing.",
        )


def place(points: NDArray[np.float64]) -> str:
    """Coordinates as a reader types them into a viewer.

    >>> place(np.array([1.0, -2.34567, 0.0]))
    '(1, -2.346, 0) mm'
    """
    return "(" + ", ".join(f"{x + 0.0:.4g}" for x in points) + ") mm"


def _refusal(name: str, found: str, bound: str, remedy: str) -> InputError:
    return InputError(f"{name}: {found}: {bound}.", remedy=remedy)


def components(mesh: TriangleMesh) -> NDArray[np.int64]:
    """Number of the connected component of each face, the largest first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]]])
    size = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(size, size))
    _, of_vertex = connected_components(graph, directed=False)
    of_face = of_vertex[mesh.faces[:, 0]]
    labels, inverse, counts = np.unique(of_face, return_inverse=True, return_counts=True)
    rank = np.empty(len(labels), dtype=np.int64)
    rank[np.argsort(-counts, kind="stable")] = np.arange(len(labels))
    return np.asarray(rank[inverse])


def _one(mesh: TriangleMesh, name: str, max_faces: int) -> list[str]:
    if len(mesh.faces) == 0 or len(mesh.vertices) == 0:
        raise _refusal(name, "no faces", "must not be empty", "Check the file, the label or the threshold.")
    refuse_too_many(len(mesh.faces), max_faces)
    bad = ~np.isfinite(mesh.vertices).all(axis=1)
    if bad.any():
        at = int(np.argmax(bad))
        shown = f"{int(bad.sum())} vertices not finite, first vertex {at}: {mesh.vertices[at].tolist()}"
        raise _refusal(name, shown, "must be finite", "Remove those vertices, or export the mesh again.")
    _degenerate(mesh, name)
    _edges(mesh, name)
    _touching(mesh, name)
    if mesh.volume <= 0:
        shown = f"volume {mesh.volume:.4g} mm³, face 0 at {place(_centre(mesh, 0))}"
        raise _refusal(name, shown, "faces must look outwards", "Turn all faces over (flip normals).")
    _crossings(mesh, name)
    return _oddities(mesh)


def _degenerate(mesh: TriangleMesh, name: str) -> None:
    f = mesh.faces
    repeated = (f[:, 0] == f[:, 1]) | (f[:, 1] == f[:, 2]) | (f[:, 2] == f[:, 0])
    flat = repeated | (mesh.face_heights <= _FLAT * float(mesh.extent.max()))
    if flat.any():
        at = int(np.argmax(flat))
        shown = f"{int(flat.sum())} faces without area, first face {at} at {place(_centre(mesh, at))}"
        raise _refusal(name, shown, "faces must have an area", "Merge close vertices and remove such faces.")


def _edges(mesh: TriangleMesh, name: str) -> None:
    size = len(mesh.vertices)
    start = mesh.faces.astype(np.int64).T.reshape(-1)  # edges 0→1, 1→2, 2→0 of all faces
    end = np.roll(mesh.faces.astype(np.int64), -1, axis=1).T.reshape(-1)
    undirected = np.minimum(start, end) * size + np.maximum(start, end)
    _, inverse, counts = np.unique(undirected, return_inverse=True, return_counts=True)
    many = counts[inverse] > 2
    if many.any():
        shown = f"{int((counts > 2).sum())} edges of three faces or more, {_edge(mesh, many)}"
        raise InputError.of(
            name, shown, "must have two at every edge", "Remove inner walls and doubled faces. " + _REPAIR
        )
    alone = counts[inverse] == 1
    if alone.any():
        shown = f"{int(alone.sum())} open edges, {_edge(mesh, alone)}"
        remedy = "Close the hole. " + _REPAIR
        raise _refusal(name, shown, "must be closed", remedy)
    _, inverse, counts = np.unique(start * size + end, return_inverse=True, return_counts=True)
    twice = counts[inverse] > 1
    if twice.any():
        shown = f"{int((counts > 1).sum())} edges run the same way in both faces, {_edge(mesh, twice)}"
        raise _refusal(name, shown, "faces must all look outwards", "Recalculate the normals outside. " + _REPAIR)


def _touching(mesh: TriangleMesh, name: str) -> None:
    from livlab.model.shapes import exact

    split = exact.split_vertices(mesh)
    split = split[np.isin(split, mesh.faces)]
    if len(split):
        at = int(split[0])
        shown = f"{len(split)} vertices where two sheets touch, first vertex {at} at {place(mesh.vertices[at])}"
        raise _refusal(name, shown, "must be one sheet at every vertex", "Split that vertex. " + _REPAIR)


def _crossings(mesh: TriangleMesh, name: str) -> None:
    from livlab.model.shapes import exact

    pairs = exact.self_intersections(mesh)
    if len(pairs):
        one, other = (int(k) for k in pairs[0])
        shown = f"{len(pairs)} pairs of faces cross, first faces {one} and {other} at {place(_centre(mesh, one))}"
        raise _refusal(name, shown, "must not cross itself", "Smooth it there, or take the union. " + _REPAIR)


def _nested(outer: TriangleMesh, inner: TriangleMesh) -> None:
    from livlab.model.shapes import exact

    pairs = exact.intersections(outer, inner)
    remedy = "Take a thinner shell, `how='distance'`, or smooth the outer mesh there."
    if len(pairs):
        one, other = (int(k) for k in pairs[0])
        shown = f"{len(pairs)} pairs of faces cross, first outer face {one} and inner face {other} "
        shown += f"at {place(_centre(inner, other))}"
        raise _refusal("inner mesh", shown, "must not pierce the outer mesh", remedy)
    label = components(inner)
    first = inner.faces[[int(np.argmax(label == k)) for k in range(int(label.max()) + 1)], 0]
    depth = exact.signed_distance(outer, inner.vertices[first])
    if (depth <= 0).any():
        at = int(first[int(np.argmin(depth))])
        shown = f"vertex {at} at {place(inner.vertices[at])} lies {-depth.min():.3g} mm outside"
        raise InputError.of(
            "inner mesh", shown, "must lie inside the outer mesh", "Check that both share unit and origin."
        )


def _oddities(mesh: TriangleMesh) -> list[str]:
    found = []
    label = components(mesh)
    count = int(label.max()) + 1
    if count > 1:
        at = int(np.argmax(label == 1))
        where = f"the second has {int((label == 1).sum())} faces, near {place(_centre(mesh, at))}"
        found.append(f"{count} separate components; {where}.")
    size = float(mesh.extent.max())
    unit, held = likely_unit(size)
    if unit != "mm":
        found.append(
            f"largest extent {size:.4g} mm: if this is an organ, the file's unit is likely {unit} ({held:.4g} mm)."
        )
    return found


def likely_unit(extent_mm: float) -> tuple[str, float]:
    """Unit in which an extent read as mm would be an organ's (20 to 500 mm), and the extent in mm it then has.

    >>> likely_unit(140.0), likely_unit(0.14), likely_unit(140_000.0)
    (('mm', 140.0), ('m', 140.0), ('um', 140.0))
    """
    if 1 <= extent_mm <= 2000:  # a block of tissue or a large animal's organ
        return "mm", extent_mm
    for unit, factor in (("m", 1e3), ("um", 1e-3)):
        if 20 <= extent_mm * factor <= 500:
            return unit, extent_mm * factor
    return "mm", extent_mm


def _edge(mesh: TriangleMesh, chosen: NDArray[np.bool_]) -> str:
    index = int(np.argmax(chosen))
    corner, face = divmod(index, len(mesh.faces))
    ends = mesh.vertices[mesh.faces[face, [corner, (corner + 1) % 3]]]
    return f"one of face {face} at {place(ends.mean(axis=0))}"


def _centre(mesh: TriangleMesh, face: int) -> NDArray[np.float64]:
    return np.asarray(mesh.vertices[mesh.faces[face]].mean(axis=0))
