"""The inner surface of a shell: a mesh moved inwards by a thickness, and the thickness that came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from livlab.errors import InputError
from livlab.model.shapes.checks import check, check_inner
from livlab.model.shapes.distance import distance_field
from livlab.model.shapes.mesh import FloatArray, TriangleMesh
from livlab.model.shapes.refine import Index, edges, split

How = Literal["distance", "normal", "scale"]

_SAMPLES = 20_000
_SHARE = 0.1
_ROUNDS = 5
_CHORD = 0.05
_SETTLED = 0.003


@dataclass(frozen=True)
class Thickness:
    """Distances in mm from points spread evenly over one surface to the nearest point of another.

    `outside_share` is the share of the area where it differs from what was asked for by more than a tenth.
    """

    minimum_mm: float
    median_mm: float
    maximum_mm: float
    outside_share: float


@dataclass(frozen=True, eq=False)
class Inset:
    """Inner surface of a shell.

    Parameters
    ----------
    mesh
        The inner surface.
    depth
        From the inner surface to the outer: how deep the shell ends.
    thickness
        From the outer surface to the inner: how much shell lies under each place. Larger than `depth` at edges and
        thin parts, which the inner surface does not reach.
    warnings
        What `check` found odd.
    """

    mesh: TriangleMesh
    depth: Thickness
    thickness: Thickness
    warnings: tuple[str, ...]


def inset(mesh: TriangleMesh, thickness_mm: float, how: How = "distance", *, spacing_mm: float | None = None) -> Inset:
    """Move a closed mesh inwards by a thickness.

    Parameters
    ----------
    mesh
        Closed; see `check`.
    thickness_mm
        Of the shell between `mesh` and the result.
    how
        "distance": the surface at this distance from the mesh, by marching cubes in the distance field and then, vertex
        by vertex, in exact distance. "normal": each vertex moved against its normal. "scale": the mesh shrunk about the
        centre of its volume (Nunes 2019, Fig. 6.5), by 1 - t A / (3 V), which makes the shell's mean thickness t
        because the mean of (x - c) · n over a closed surface is 3 V / A; elsewhere it is thicker or thinner.
    spacing_mm
        Of the distance field: unless said a third of the thickness, between a 280th and a 100th of the largest
        extent.

    Raises
    ------
    InputError
        The mesh is not sound, nothing is left inside, or the inner surface crosses itself or the outer one; the
        message names the place.

    Examples
    --------
    >>> from livlab.model.shapes import sphere
    >>> shell = inset(sphere(10.0), 0.5, "scale")
    >>> round(shell.depth.median_mm, 2), shell.depth.outside_share
    (0.5, 0.0)
    """
    if not (np.isfinite(thickness_mm) and thickness_mm > 0):
        raise InputError.of("thickness_mm", thickness_mm, "must be > 0", "Give a positive length in mm.")
    make: dict[str, Callable[[], TriangleMesh]] = {
        "distance": lambda: _by_distance(mesh, thickness_mm, spacing_mm),
        "normal": lambda: TriangleMesh(mesh.vertices - thickness_mm * mesh.vertex_normals, mesh.faces),
        "scale": lambda: _by_scale(mesh, thickness_mm),
    }
    if how not in make:
        raise InputError.of("how", how, f"must be one of {', '.join(make)}", "Take distance.")
    check(mesh)
    inner = make[how]()
    if inner.volume <= 0:
        _refuse_thick(mesh, thickness_mm)
    warnings = check_inner(mesh, inner)
    return Inset(
        inner,
        measure(inner, mesh, thickness_mm),
        measure(mesh, inner, thickness_mm),
        warnings,
    )


def measure(start: TriangleMesh, target: TriangleMesh, wanted_mm: float, *, seed: int = 0) -> Thickness:
    """Distance from one surface to another at points spread evenly over the first, its vertices included."""
    from livlab.model.shapes import exact

    spread = exact.nearest(target, scattered(start, _SAMPLES, seed))[0]
    corners = exact.nearest(target, start.vertices)[0]
    outside = np.abs(spread - wanted_mm) > _SHARE * wanted_mm
    return Thickness(
        float(min(spread.min(), corners.min())),
        float(np.median(spread)),
        float(max(spread.max(), corners.max())),
        float(outside.mean()),
    )


def scattered(mesh: TriangleMesh, count: int, seed: int = 0) -> FloatArray:
    """Points (count, 3) spread over the surface, as many on each mm² (Osada et al. 2002, eq. 1)."""
    draw = np.random.default_rng(seed)
    summed = np.cumsum(mesh.face_areas)
    face = np.minimum(
        np.searchsorted(summed, (np.arange(count) + draw.random(count)) / count * summed[-1]), len(summed) - 1
    )
    a, b, c = (mesh.vertices[mesh.faces[face, k]] for k in range(3))
    root, other = np.sqrt(draw.random((count, 1))), draw.random((count, 1))
    return np.asarray((1 - root) * a + root * (1 - other) * b + root * other * c)


def _by_scale(mesh: TriangleMesh, thickness: float) -> TriangleMesh:
    origin = mesh.bounds.mean(axis=0)
    corners = mesh.vertices[mesh.faces] - origin
    crosses = 2 * mesh.face_areas[:, None] * mesh.face_normals
    weights = np.einsum("ij,ij->i", corners[:, 0], crosses) / 6
    centre = origin + np.einsum("f,fkd->d", weights, corners) / 4 / weights.sum()
    factor = 1 - thickness * mesh.area / (3 * mesh.volume)
    if factor <= 0:
        _refuse_thick(mesh, thickness)
    return TriangleMesh(centre + factor * (mesh.vertices - centre), mesh.faces)


def _by_distance(mesh: TriangleMesh, thickness: float, spacing: float | None) -> TriangleMesh:
    from skimage.measure import marching_cubes

    from livlab.model.shapes import exact

    if thickness >= float(mesh.extent.min()) / 2:
        _refuse_thick(mesh, thickness)
    size = float(mesh.extent.max())
    step = max(size / 280, min(thickness / 3, size / 100)) if spacing is None else spacing
    field = distance_field(mesh, step, band_mm=max(3 * step, thickness + 2 * step))
    if not float(field.values.max()) > thickness:
        _refuse_thick(mesh, thickness)
    found = marching_cubes(field.values, thickness, spacing=(step,) * 3, gradient_direction="descent")
    inner = TriangleMesh(np.asarray(found[0], dtype=np.float64)[:, ::-1] + field.origin_mm, found[1])
    inner = inner if inner.volume > 0 else inner.flipped()
    smooth = _without_slivers(inner)
    settled = smooth
    for _ in range(2):
        settled = _settled(mesh, settled, np.arange(len(smooth.vertices)), thickness)
    fine = _untangled(_refined(mesh, settled, thickness, shortest=step / 3))
    # Moving vertices may fold a crease for good. What marching cubes gave does not cross itself, only is less exact.
    return fine if len(exact.self_intersections(fine)) == 0 else inner


def _without_slivers(mesh: TriangleMesh) -> TriangleMesh:
    """Let vertices slide towards their neighbours' mean: marching cubes leaves needles."""
    import trimesh

    loose = mesh.as_trimesh()
    trimesh.smoothing.filter_taubin(loose, lamb=0.5, nu=0.53, iterations=4)  # type: ignore[no-untyped-call]
    return TriangleMesh(loose.vertices, loose.faces)


def _settled(outer: TriangleMesh, inner: TriangleMesh, which: Index, thickness: float) -> TriangleMesh:
    """Move these vertices until their depth is right: to or from the nearest point of the outer mesh.

    Where that line leaves the inner mesh's normal by more than 45° the nearest point jumps from one vertex to the next
    and would send neighbours different ways; there the normal is followed instead. No vertex goes farther than a third
    of its shortest edge, so that faces do not turn over.
    """
    from livlab.model.shapes import exact

    points = inner.vertices.copy()
    normals = inner.vertex_normals
    leash = _shortest_edge(inner) / 3
    wrong = which
    for _ in range(_ROUNDS):
        depth, outwards = exact.depth(outer, points[wrong])
        far = np.abs(depth - thickness) > _SETTLED * thickness
        wrong, depth, outwards = wrong[far], depth[far], outwards[far]
        if len(wrong) == 0:
            break
        along = np.einsum("ij,ij->i", outwards, normals[wrong]) > np.cos(np.pi / 4)
        points[wrong] += (depth - thickness)[:, None] * np.where(along[:, None], outwards, normals[wrong])
        way = points[wrong] - inner.vertices[wrong]
        shorten = np.minimum(1.0, leash[wrong] / np.maximum(np.linalg.norm(way, axis=1), 1e-12))
        points[wrong] = inner.vertices[wrong] + shorten[:, None] * way
    return TriangleMesh(points, inner.faces)


def _shortest_edge(mesh: TriangleMesh) -> FloatArray:
    ends, _ = edges(mesh)
    length = np.linalg.norm(mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]], axis=1)
    shortest = np.full(len(mesh.vertices), np.inf)
    for side in range(2):
        np.minimum.at(shortest, ends[:, side], length)
    return shortest


def _untangled(inner: TriangleMesh) -> TriangleMesh:
    """Where faces cross, let the vertices around go to their neighbours' mean; what still crosses is for `check`."""
    from livlab.model.shapes import exact

    loose = np.zeros(len(inner.vertices), dtype=bool)
    for rings in range(1, _ROUNDS + 1):  # what does not come free in a small patch may in a wider one
        crossing = np.unique(exact.self_intersections(inner))
        if len(crossing) == 0:
            break
        loose[inner.faces[crossing]] = True
        for _ in range(rings):
            loose[inner.faces[loose[inner.faces].any(axis=1)]] = True
        ends, _ = edges(inner)
        ends = ends[loose[ends].any(axis=1)]
        both = np.concatenate([ends, ends[:, ::-1]])
        points = inner.vertices.copy()
        for _ in range(3):
            count = np.bincount(both[:, 0], minlength=len(points))
            total = np.stack([np.bincount(both[:, 0], points[both[:, 1], k], len(points)) for k in range(3)], axis=-1)
            points[loose] = total[loose] / count[loose, None]
        inner = TriangleMesh(points, inner.faces)
    return inner


def _refined(outer: TriangleMesh, inner: TriangleMesh, thickness: float, shortest: float) -> TriangleMesh:
    """Split edges whose middle lies at a wrong depth: chords of a crease that is sharper than the grid."""
    from livlab.model.shapes import exact

    allowed = _CHORD * thickness
    known = 0
    for _ in range(_ROUNDS):
        ends, of_face = edges(inner)
        chord = inner.vertices[ends[:, 1]] - inner.vertices[ends[:, 0]]
        length = np.linalg.norm(chord, axis=1)
        # A chord between normals that differ by a leaves the surface by about length · a / 8: most need no question.
        turn = np.linalg.norm(inner.vertex_normals[ends[:, 1]] - inner.vertex_normals[ends[:, 0]], axis=1)
        asked = np.flatnonzero((length > shortest) & (length * turn / 8 > allowed / 4) & (ends.max(axis=1) >= known))
        depth = exact.nearest(outer, inner.vertices[ends[asked]].mean(axis=1))[0]
        chosen = np.zeros(len(ends), dtype=bool)
        chosen[asked[np.abs(depth - thickness) > allowed]] = True
        if not chosen.any():
            break
        known = len(inner.vertices)
        finer = split(inner, ends, of_face, chosen)
        inner = _settled(outer, finer, np.arange(known, len(finer.vertices)), thickness)
    return inner


def _refuse_thick(mesh: TriangleMesh, thickness: float) -> None:
    size = float(mesh.extent.min())
    raise InputError.of(
        "thickness_mm", thickness, f"leaves nothing inside a mesh {size:.4g} mm across", "Check the unit, or take less."
    )
