"""A liver made by code: an implicit solid with its lobes, notch and beds, meshed by marching cubes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.shapes import cache
from livlab.model.shapes.mesh import TriangleMesh

Field = NDArray[np.float64]
Point = tuple[float, float, float]

_VERSION = 4


def liver(size_mm: float = 140.0, resolution_mm: float = 0.75, *, cached: bool = True) -> TriangleMesh:
    """Liver-like solid, `size_mm` from right to left.

    Axes are those of medical images (LPS): x to the body's left, y to its back, z to its head; so the large right lobe
    lies at negative x, the dome under the diaphragm at high z, the visceral side looks down and back, and the sharp
    inferior margin looks to the front.

    Parameters
    ----------
    size_mm
        Extent along x.
    resolution_mm
        Edge of the marching cubes at 140 mm; larger livers scale it along.
    cached
        Keep the mesh on disk and take it from there.

    Raises
    ------
    InputError
        A length is not positive, or the resolution is finer than 0.2 mm or coarser than 4 mm.
    """
    if not (np.isfinite(size_mm) and size_mm > 0):
        raise InputError.of("size_mm", size_mm, "must be > 0", "Give a positive length in mm.")
    if not 0.2 <= resolution_mm <= 4:
        raise InputError.of("resolution_mm", resolution_mm, "must lie in 0.2..4", "0.75 mm makes 180,000 faces.")
    name = cache.key("liver", _VERSION, float(size_mm), float(resolution_mm))
    kept = cache.recall("liver", name) if cached else None
    if kept is not None:
        return TriangleMesh(kept["vertices"], kept["faces"])
    raw = _mesh(resolution_mm)
    centred = raw.moved(-raw.bounds.mean(axis=0))
    made = centred.scaled(size_mm / float(centred.extent[0]))
    if cached:
        cache.remember("liver", name, {"vertices": made.vertices, "faces": made.faces})
    return made


def _mesh(step: float) -> TriangleMesh:
    import trimesh
    from skimage.measure import marching_cubes

    low, high = np.array([-80.0, -56.0, -66.0]), np.array([84.0, 58.0, 62.0])
    axes = [np.arange(low[k], high[k] + step, step) for k in range(3)]
    values = solid(*(np.asarray(a, dtype=np.float64) for a in np.meshgrid(*axes, indexing="ij", sparse=True)))
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(step,) * 3, gradient_direction="descent")
    smooth = trimesh.Trimesh(vertices=vertices + low, faces=faces, process=False)
    smooth = max(smooth.split(only_watertight=True), key=lambda part: float(part.volume))
    trimesh.smoothing.filter_taubin(smooth, lamb=0.5, nu=0.53, iterations=10)  # type: ignore[no-untyped-call]
    return TriangleMesh(smooth.vertices, smooth.faces)


def solid(x: Field, y: Field, z: Field) -> Field:
    """Implicit function of the liver of about 140 mm, in mm, negative inside and close to a distance near the surface.

    Ellipsoids joined and cut by Quílez's polynomial smooth minimum; the dome is cut from below and behind by a large
    sphere, which leaves the concave visceral side and the sharp inferior margin.
    """
    # A slow wobble, so that nothing is a perfect quadric.
    wx = x + 1.3 * np.sin(z / 17.0 + 0.6) * np.cos(y / 21.0)
    wy = y + 1.1 * np.sin(x / 19.0 + 1.9) * np.cos(z / 23.0 + 0.4)
    wz = z + 1.2 * np.sin(x / 23.0 + 0.3) * np.cos(y / 16.0 + 1.1)

    right = _ellipsoid(wx, wy, wz, (-27, 1, -9), (43, 43, 58))
    shoulder = _ellipsoid(wx, wy, wz, (-4, -7, 8), (44, 35, 36))
    left = _ellipsoid(wx, wy, wz - 0.12 * (wx - 30), (30, -13, 14), (49, 26, 20))
    dome = _join(_join(right, shoulder, 18.0), left, 16.0)
    # The falciform ligament: a shallow crease over the front of the dome.
    line = wx - 17 - 0.10 * wz
    dome = dome + 1.6 * np.exp(-((line / 2.6) ** 2)) * _step((-wy - 4) / 10)

    visceral = _ellipsoid(wx, wy, wz, (35, 66, -116), (140, 140, 138))
    # What lies on the visceral side, seen from below: beds, fissures and the two small lobes between them.
    visceral = visceral - _groove(x, y, (-16, -46), (-9, -8), 8.0, 7.5)  # gallbladder
    visceral = visceral - _groove(x, y, (17, -52), (12, 0), 4.6, 8.5)  # umbilical fissure and its notch
    visceral = visceral - _groove(x, y, (-9, 0), (12, 0), 5.0, 4.0)  # porta
    visceral = visceral - _groove(x, y, (13, 4), (10, 19), 4.2, 4.0)  # fissure of the venous ligament
    visceral = visceral + _groove(x, y, (-1, 14), (0, 18), 6.0, 5.0)  # caudate lobe
    visceral = visceral + _groove(x, y, (3, -26), (3, -14), 6.0, 2.0)  # quadrate lobe
    visceral = visceral - _groove(x, y, (-40, 22), (-38, 30), 13.0, 6.0)  # kidney
    visceral = visceral - _groove(x, y, (38, -12), (70, -12), 17.0, 9.0)  # stomach
    visceral = visceral - _groove(x, y, (-46, -2), (-24, -17), 13.0, 5.0)  # colon, behind the inferior margin
    body = _cut(dome, visceral, 3.6)

    cava = _ellipsoid(wx, wy, wz, (-3, 41, 16), (10, 11, 70))
    return _cut(body, cava, 4.0)


def _step(t: Field) -> Field:
    """0 below 0, 1 above 1, smooth between."""
    held = np.clip(t, 0.0, 1.0)
    return np.asarray(held * held * (3 - 2 * held))


def _groove(
    x: Field, y: Field, start: tuple[float, float], end: tuple[float, float], width: float, deep: float
) -> Field:
    """Depth in mm of a Gaussian trough along a line, seen along z; its floor is round, of radius width²/(2 deep)."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    along = np.clip(((x - start[0]) * dx + (y - start[1]) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
    squared = (x - start[0] - along * dx) ** 2 + (y - start[1] - along * dy) ** 2
    return np.asarray(deep * np.exp(-squared / width**2))


def _ellipsoid(x: Field, y: Field, z: Field, centre: Point, radii: Point) -> Field:
    """Signed distance to an ellipsoid to first order, negative inside."""
    offsets = [value - c for value, c in zip((x, y, z), centre, strict=True)]
    scaled = np.sqrt(sum((offset / r) ** 2 for offset, r in zip(offsets, radii, strict=True)))
    gradient = np.sqrt(sum((offset / r**2) ** 2 for offset, r in zip(offsets, radii, strict=True)))
    return np.asarray(scaled * (scaled - 1) / np.maximum(gradient, 1e-9))


def _join(one: Field, other: Field, width: float) -> Field:
    """Smooth union: the minimum, rounded over `width` mm."""
    h = np.maximum(width - np.abs(one - other), 0.0) / width
    return np.asarray(np.minimum(one, other) - h**2 * width / 4)


def _cut(one: Field, tool: Field, width: float) -> Field:
    """Smooth difference: what is in `one` and not in `tool`, its edge rounded over `width` mm."""
    return -_join(-one, tool, width)
