"""Signed distance to a mesh on a grid: exact near the surface, a safe lower bound away from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from livlab.errors import InputError
from livlab.model.shapes import cache
from livlab.model.shapes.mesh import FloatArray, TriangleMesh

MAX_NODES = 250_000_000
"""1 GB of float32 values."""

_PAD = 2  # nodes outside the mesh on each side
_QUERY_NODES = 1_000_000
_VERSION = 2  # 2: where a mesh has needles, lengths are no longer scaled by the winding number


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distance to a surface at the nodes of a cubic grid.

    Node (k, j, i) lies at `origin_mm` + `spacing_mm` · (i, j, k).

    Parameters
    ----------
    origin_mm
        Position of node (0, 0, 0), as x, y, z.
    spacing_mm
        Distance of neighbouring nodes.
    values
        float32 [z, y, x] in mm, positive inside. Where the surface is nearer than `band_mm` the value is the distance
        to the mesh, to float32; elsewhere its modulus lies between `band_mm` and the distance.
    band_mm
        Half-width of the exact band around the surface.
    """

    origin_mm: FloatArray
    spacing_mm: float
    values: NDArray[np.float32]
    band_mm: float

    @property
    def margin_mm(self) -> float:
        """How far the trilinear value can lie above the true distance at worst: √3/2 of the spacing.

        A distance changes by no more than the path walked, and a point is on average (by trilinear weights) no
        farther than √3/2 of a cell from the nodes; so `at(p)` - `margin_mm` is a step that cannot reach the surface.
        """
        return float(np.sqrt(3) / 2 * self.spacing_mm)

    @property
    def bytes(self) -> int:
        """Memory of the values."""
        return int(self.values.nbytes)

    def at(self, points_mm: ArrayLike) -> FloatArray:
        """Trilinear value in mm at points (..., 3); beyond the grid a value whose modulus is a lower bound.

        The nearest point of a box that holds the mesh splits the way to it into two that meet at an obtuse angle.
        """
        points = np.asarray(points_mm, dtype=np.float64)
        shape = np.array(self.values.shape[::-1])
        place = (points - self.origin_mm) / self.spacing_mm
        held = np.clip(place, 0, shape - 1)
        low = np.minimum(held.astype(np.int64), shape - 2)
        t = held - low
        total = np.zeros(points.shape[:-1])
        for corner in np.ndindex(2, 2, 2):
            i, j, k = (low[..., axis] + corner[axis] for axis in range(3))
            weight = np.prod(np.where(corner, t, 1 - t), axis=-1)
            total += weight * self.values[k, j, i]
        away = np.linalg.norm(place - held, axis=-1) * self.spacing_mm
        return np.where(away > 0, -np.hypot(away, np.minimum(total, 0)), total)


def distance_field(
    mesh: TriangleMesh, spacing_mm: float = 0.5, *, band_mm: float | None = None, cached: bool = True
) -> DistanceField:
    """Signed distance to a closed mesh, positive inside.

    Near the surface the nearest triangle is found by libigl's tree and the sign as `exact.signed_distance` has it.
    Farther away the value is the Euclidean distance transform of the nodes next to the surface, less the most
    that the surface can lie nearer than those nodes; the sign there is the winding number of each connected region.

    Parameters
    ----------
    mesh
        Closed, with faces looking outwards; see `check`.
    spacing_mm
        Distance of neighbouring nodes. Trilinear interpolation then errs by up to spacing²/8 times the sum of the
        surface's two curvatures: about 1 µm at 0.5 mm where the radii are 60 mm.
    band_mm
        Half-width of the exact band, at least three spacings, which is the default.
    cached
        Keep the result on disk under the digest of mesh, spacing and band, and take it from there.

    Returns
    -------
    field
        4 bytes a node; the making needs about 15 bytes a node and 0.3 GB for the queries near the surface.

    Raises
    ------
    InputError
        The spacing is not positive or gives too many nodes, or the mesh is not closed or not consistently turned.

    Examples
    --------
    >>> from livlab.model.shapes import box
    >>> field = distance_field(box(10.0), 1.0, cached=False)
    >>> field.at([[0, 0, 4.9], [0, 0, 5.5]]).round(5).tolist()
    [0.1, -0.5]
    """
    if not (np.isfinite(spacing_mm) and spacing_mm > 0):
        raise InputError.of("spacing_mm", spacing_mm, "must be > 0", "Give a positive length in mm.")
    band = 3.0 * spacing_mm if band_mm is None else float(band_mm)
    if not (np.isfinite(band) and band >= 3.0 * spacing_mm * (1 - 1e-9)):
        raise InputError.of(
            "band_mm", band_mm, f"must be at least {3.0 * spacing_mm:g}", "Take three spacings or more."
        )
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        raise InputError.of("mesh", mesh, "must have faces and finite vertices", "Run check on it.")
    nodes = np.ceil(mesh.extent / spacing_mm).astype(np.int64) + 1 + 2 * _PAD
    if float(np.prod(nodes, dtype=np.float64)) > MAX_NODES:
        coarser = spacing_mm * (float(np.prod(nodes, dtype=np.float64)) / MAX_NODES) ** (1 / 3)
        bound = f"would need {np.prod(nodes, dtype=np.float64) / 1e6:.0f} million nodes of {MAX_NODES / 1e6:.0f}"
        raise InputError.of(
            "spacing_mm", spacing_mm, bound, f"Take {coarser:.2g} mm or more, or check the mesh's unit."
        )
    name = cache.key("distance", _VERSION, mesh.digest, float(spacing_mm), band)
    origin = (mesh.bounds.sum(axis=0) - (nodes - 1) * spacing_mm) / 2
    kept = cache.recall("distance", name) if cached else None
    if kept is not None and kept["values"].shape == tuple(nodes[::-1]):
        return DistanceField(origin, float(spacing_mm), np.asarray(kept["values"], dtype=np.float32), band)
    values = _values(mesh, origin, float(spacing_mm), nodes, band)
    if cached:
        cache.remember("distance", name, {"values": values})
    return DistanceField(origin, float(spacing_mm), values, band)


def _values(
    mesh: TriangleMesh, origin: FloatArray, spacing: float, nodes: NDArray[np.int64], band: float
) -> NDArray[np.float32]:
    from scipy import ndimage

    from livlab.model.shapes import exact
    from livlab.model.shapes.transform import distance_to

    shape = tuple(int(n) for n in nodes[::-1])
    touched = np.zeros(shape, dtype=bool)
    for points in _lattice(mesh, spacing):
        i, j, k = np.rint((points - origin) / spacing).astype(np.int64).T
        touched[k, j, i] = True
    # A surface point is within 1/√3 of a lattice point, and that within √3/2 of a touched node.
    reach = 1.0001 * (1 / np.sqrt(3) + np.sqrt(3) / 2) * spacing  # float32 rounds
    values = distance_to(touched)
    del touched
    values *= np.float32(spacing)
    values -= np.float32(reach)
    near = values <= band

    flat = np.flatnonzero(near)
    for start in range(0, len(flat), _QUERY_NODES):
        part = flat[start : start + _QUERY_NODES]
        k, j, i = np.unravel_index(part, shape)
        values.reshape(-1)[part] = exact.signed_distance(mesh, origin + spacing * np.stack([i, j, k], axis=-1))
    far, regions = ndimage.label(~near)
    if regions:
        values[~near] *= _region_signs(mesh, origin, spacing, far, regions)[far[~near]]
    _refuse_torn(values, near, origin, spacing)
    return values


def _lattice(mesh: TriangleMesh, step: float) -> Iterator[FloatArray]:
    """Points on every face, the corners included, no farther apart than `step`."""
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(1, np.ceil(longest / step)).astype(np.int64)
    for count in np.unique(parts):
        i, j = (index.reshape(-1) for index in np.mgrid[: count + 1, : count + 1])
        rows = np.stack([count - i - j, i, j], axis=-1)[i + j <= count] / count
        chosen = np.flatnonzero(parts == count)
        size = max(1, 2_000_000 // len(rows))
        for start in range(0, len(chosen), size):
            yield np.einsum("wk,fkd->fwd", rows, corners[chosen[start : start + size]]).reshape(-1, 3)


def _region_signs(
    mesh: TriangleMesh, origin: FloatArray, spacing: float, far: NDArray[np.integer], regions: int
) -> NDArray[np.float32]:
    """+1 or -1 of each region by the winding number at one of its nodes."""
    from livlab.model.shapes import exact

    numbered = far.reshape(-1)
    places = np.flatnonzero(numbered)
    one_of = np.zeros(regions + 1, dtype=np.int64)
    one_of[numbered[places]] = places
    signs = np.ones(regions + 1, dtype=np.float32)
    for label in range(1, regions + 1):
        k, j, i = np.unravel_index(int(one_of[label]), far.shape)
        node = origin + spacing * np.array([i, j, k], dtype=np.float64)
        winding = exact.winding_number(mesh, node)
        if abs(winding - round(winding)) > 0.01 or round(winding) not in (0, 1):
            place_mm = ", ".join(f"{x:.3g}" for x in node)
            raise InputError.of(
                "mesh",
                f"winding number {winding:.3g} at ({place_mm}) mm",
                "must be 0 outside and 1 inside",
                "The mesh has holes, overlaps itself or looks inwards: run `check` on it.",
            )
        signs[label] = 1 if round(winding) == 1 else -1
    return signs


def _refuse_torn(values: NDArray[np.float32], near: NDArray[np.bool_], origin: FloatArray, spacing: float) -> None:
    """Neighbours of which one is far from the surface lie on the same side; otherwise the mesh is torn."""
    for axis in range(3):
        ahead = [slice(None)] * 3
        behind = [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        one, other = tuple(behind), tuple(ahead)
        edge = near[one] != near[other]
        torn = edge & (np.signbit(values[one]) != np.signbit(values[other]))
        if torn.any():
            k, j, i = np.unravel_index(int(np.argmax(torn)), torn.shape)
            place_mm = ", ".join(f"{x:.4g}" for x in origin + spacing * np.array([i, j, k]))
            raise InputError.of(
                "mesh", f"inside meets outside at ({place_mm}) mm", "must be closed", "Run `check` on it."
            )
