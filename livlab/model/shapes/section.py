"""Sections by constructive solid geometry: nested meshes cut by a plane or opened by a wedge, still closed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from livlab.errors import InputError
from livlab.model.shapes.mesh import FloatArray, TriangleMesh
from livlab.model.shapes.refine import without_flat

_SLIVER = 1e-8  # of the extent: what rounding leaves along a cut


@dataclass(frozen=True)
class Plane:
    """A plane through a point in mm; what lies on the side its normal points to is taken away.

    >>> Plane((0, 0, 5), (0, 0, 2)).unit.tolist()
    [0.0, 0.0, 1.0]
    """

    point_mm: tuple[float, float, float]
    normal: tuple[float, float, float]

    def __post_init__(self) -> None:
        for name in ("point_mm", "normal"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError.of(
                    f"plane.{name}", getattr(self, name), "must be three finite numbers", "Give x, y, z."
                )
        if not np.any(np.asarray(self.normal, dtype=np.float64)):
            raise InputError.of("plane.normal", self.normal, "must not be zero", "Give a direction, (0, -1, 0) say.")

    @property
    def unit(self) -> FloatArray:
        """Normal of length one."""
        normal = np.asarray(self.normal, dtype=np.float64)
        return np.asarray(normal / np.linalg.norm(normal))

    @property
    def offset_mm(self) -> float:
        """Signed distance of the plane from the origin, along the normal."""
        return float(self.unit @ np.asarray(self.point_mm, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class MeshSection:
    """Cut meshes, outer first; `removed_mm3` of the outer's volume is gone."""

    outer: TriangleMesh
    inner: TriangleMesh | None
    removed_mm3: float


def section(
    outer: TriangleMesh, inner: TriangleMesh | None = None, *, planes: Plane | list[Plane], gap_mm: float = 0.01
) -> MeshSection:
    """Take away what lies beyond one plane, or beyond all of several: two make a wedge, three a corner.

    On the cut the inner mesh's new face lies `gap_mm` behind the outer's. Two faces in one place would leave it to
    rounding which one a ray meets first; a renderer moves its rays by some µm at coordinates of 100 mm, so that less
    than that does not help. With a depth test there is no inner mesh and no gap: cut the outer mesh alone and measure
    depth in the distance field of the uncut one.

    Parameters
    ----------
    outer, inner
        Closed meshes, one in the other; `inner` may be missing.
    planes
        One or several.
    gap_mm
        Thickness of outer medium left on the cut.

    Raises
    ------
    InputError
        A mesh is not closed, the planes miss it, leave nothing of it, or the gap is not positive.

    Examples
    --------
    >>> from livlab.model.shapes import box
    >>> half = section(box(10.0), box(9.0), planes=Plane((0, 0, 0), (0, 0, 1)), gap_mm=0.5)
    >>> round(half.outer.volume, 9), round(half.inner.volume, 9)
    (500.0, 324.0)
    """
    several = [planes] if isinstance(planes, Plane) else list(planes)
    if not several:
        raise InputError.of("planes", planes, "must hold a plane", "Give one to cut, two to remove a wedge.")
    if not (np.isfinite(gap_mm) and gap_mm > 0):
        raise InputError.of("gap_mm", gap_mm, "must be > 0", "0.01 mm hides nothing and keeps the two faces apart.")
    cut = _without(outer, several, 0.0, "outer")
    removed = outer.volume - cut.volume
    if removed <= 1e-9 * outer.volume:
        raise InputError.of("planes", several, "must cut the mesh", f"It reaches from {outer.bounds.tolist()} mm.")
    return MeshSection(cut, None if inner is None else _without(inner, several, gap_mm, "inner"), removed)


def wedge(edge_point_mm: ArrayLike, edge: ArrayLike, middle: ArrayLike, opening: float) -> list[Plane]:
    """Two planes that remove a wedge of this opening, in radians below π.

    Parameters
    ----------
    edge_point_mm, edge
        A point of the wedge's edge and its direction.
    middle
        Direction from the edge into the middle of what is removed; its part along the edge does not count.
    opening
        Angle between the planes.

    Examples
    --------
    >>> from livlab.model.shapes import box
    >>> quarter = wedge((0, 0, 0), (0, 0, 1), (1, 1, 0), np.pi / 2)
    >>> round(section(box(10.0), planes=quarter).removed_mm3, 9)
    250.0
    """
    along, into = np.asarray(edge, dtype=np.float64), np.asarray(middle, dtype=np.float64)
    if not (0 < opening < np.pi):
        raise InputError.of("opening", opening, "must lie between 0 and π", "Use one plane to remove a half.")
    along = along / max(float(np.linalg.norm(along)), 1e-300)
    into = into - (into @ along) * along
    if not np.linalg.norm(into) > 1e-9:
        raise InputError.of("middle", middle, "must not lie along the edge", "Point it into what is removed.")
    into = into / np.linalg.norm(into)
    across = np.cross(along, into)
    half = opening / 2
    x, y, z = (float(value) for value in np.asarray(edge_point_mm, dtype=np.float64))
    normals = [np.sin(half) * into + sign * np.cos(half) * across for sign in (1.0, -1.0)]
    return [Plane((x, y, z), (float(n[0]), float(n[1]), float(n[2]))) for n in normals]


def _without(mesh: TriangleMesh, planes: list[Plane], back_mm: float, name: str) -> TriangleMesh:
    from livlab.model.shapes.solids import mesh_of, solid

    whole = solid(mesh, name)
    if len(planes) == 1:
        left = whole.trim_by_plane(tuple(-planes[0].unit), -(planes[0].offset_mm - back_mm))
    else:
        left = whole - _beyond(planes, back_mm, reach_mm=4 * float(np.abs(mesh.bounds).max() + np.max(mesh.extent)))
    if left.is_empty():
        raise InputError.of(
            "planes", planes, f"leave nothing of the {name} mesh", "Turn the normal, or move the plane."
        )
    sliver = _SLIVER * float(mesh.extent.max())
    made = mesh_of(left.simplify(sliver))
    for _ in range(3):  # a swap may leave its neighbour flat
        made = without_flat(made, sliver / 100)
    return made


def _beyond(planes: list[Plane], back_mm: float, reach_mm: float) -> Any:
    """What lies beyond all planes, each moved back by `back_mm`, within a cube of this edge about the origin."""
    import manifold3d  # type: ignore[import-not-found]

    made = manifold3d.Manifold.cube((reach_mm,) * 3, True)
    for plane in planes:
        made = made.trim_by_plane(tuple(plane.unit), plane.offset_mm - back_mm)
    return made
