"""From a segmentation to a closed surface: crop, soften, marching cubes, smooth, thin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from livlab.errors import InputError
from livlab.model.shapes.checks import components, refuse_too_many
from livlab.model.shapes.mesh import FloatArray, TriangleMesh


@dataclass(frozen=True, eq=False)
class Segmentation:
    """What is inside, on a regular grid.

    Parameters
    ----------
    inside
        Boolean, three axes.
    affine
        (4, 4): from index to position in mm (x to the body's left, y to its back, z to its head where the file says).
    notes
        What had to be taken for granted.
    """

    inside: NDArray[np.bool_]
    affine: FloatArray
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.inside.ndim != 3:
            raise InputError.of("volume", self.inside.shape, "must have three axes", "Pick one time point or channel.")
        spacing = self.spacing_mm
        if not (np.isfinite(self.affine).all() and (spacing > 0).all() and np.linalg.det(self.affine[:3, :3]) != 0):
            raise InputError.of("voxel spacing", spacing.tolist(), "must be > 0", "Give --spacing, in mm.")
        if not self.inside.any():
            raise InputError.of("volume", "no voxel inside", "must not be empty", "Check label and threshold.")

    @property
    def spacing_mm(self) -> FloatArray:
        """Length of a voxel along each axis of the array."""
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    @property
    def volume_mm3(self) -> float:
        """Volume of the voxels inside."""
        return float(self.inside.sum() * abs(np.linalg.det(self.affine[:3, :3])))


@dataclass(frozen=True, eq=False)
class SegmentedSurface:
    """Mesh of a segmentation, and notes on what it took."""

    mesh: TriangleMesh
    notes: tuple[str, ...]


def surface(
    segmentation: Segmentation, *, smoothing_mm: float | None = None, faces: int | None = None, keep: str = "largest"
) -> SegmentedSurface:
    """Closed surface of a segmentation.

    The indicator is blurred by a Gaussian, so that marching cubes (Lewiner et al. 2003) at one half finds a surface
    between the voxels and not their steps; Taubin's filter (1995) then evens the triangles without shrinking them.

    Parameters
    ----------
    segmentation
        What is inside.
    smoothing_mm
        Standard deviation of the blur: seven tenths of the longest voxel edge unless said; 0 for none. Parts thinner
        than about twice this vanish.
    faces
        Most faces; more are thinned out.
    keep
        "largest" or "all" separate parts.

    Raises
    ------
    InputError
        Nothing is left after the blur, or there are too many faces.
    """
    from scipy import ndimage
    from skimage.measure import marching_cubes

    spacing = segmentation.spacing_mm
    blur = 0.7 * float(spacing.max()) if smoothing_mm is None else float(smoothing_mm)
    if not (np.isfinite(blur) and blur >= 0):
        raise InputError.of("smoothing_mm", smoothing_mm, "must be >= 0", "Give a length in mm, 0 for none.")
    if keep not in ("largest", "all"):
        raise InputError.of("keep", keep, "must be largest or all", "Take largest.")
    notes = list(segmentation.notes)
    occupied = ndimage.find_objects(segmentation.inside.astype(np.int8))[0]
    if any(s.start == 0 or s.stop == n for s, n in zip(occupied, segmentation.inside.shape, strict=True)):
        notes.append("The segmentation touches the border of its volume: the surface is cut flat there.")
    sigma = blur / spacing
    pad = np.ceil(4 * sigma).astype(int) + 2
    held = np.pad(segmentation.inside[occupied], [(int(p), int(p)) for p in pad]).astype(np.float32)
    if blur > 0:
        held = ndimage.gaussian_filter(held, sigma, mode="constant", truncate=4.0)
    if not float(held.max()) > 0.5:
        raise InputError.of("smoothing_mm", blur, "leaves nothing of so thin a part", "Smooth less.")
    found = marching_cubes(held, 0.5, gradient_direction="descent")
    refuse_too_many(len(found[1]))
    index = np.asarray(found[0], dtype=np.float64) + np.array([s.start for s in occupied]) - pad
    mesh = TriangleMesh(index @ segmentation.affine[:3, :3].T + segmentation.affine[:3, 3], found[1])
    mesh = mesh if mesh.volume > 0 else mesh.flipped()
    mesh, dropped = _kept(mesh, keep)
    notes += dropped
    if blur > 0:
        mesh = _taubin(mesh)
    if faces is not None and len(mesh.faces) > faces:
        from livlab.model.shapes.solids import thinned

        before = len(mesh.faces)
        mesh, tolerance = thinned(mesh, faces)
        notes.append(
            f"Thinned from {before:,} faces to {len(mesh.faces):,}; the surface moved by at most {tolerance:.3g} mm."
        )
    change = mesh.volume / segmentation.volume_mm3 - 1
    notes.append(f"The voxels hold {segmentation.volume_mm3:.6g} mm³, the mesh {100 * change:+.2f} % of it.")
    return SegmentedSurface(mesh, tuple(notes))


def _kept(mesh: TriangleMesh, keep: str) -> tuple[TriangleMesh, list[str]]:
    label = components(mesh)
    count = int(label.max()) + 1
    if count == 1 or keep == "all":
        return mesh, []
    parts = [TriangleMesh(mesh.vertices, mesh.faces[label == k]) for k in range(count)]
    volumes = np.array([part.volume for part in parts])
    best = int(np.argmax(volumes))
    chosen = parts[best].faces
    used, faces = np.unique(chosen, return_inverse=True)
    rest = float(np.abs(np.delete(volumes, best)).sum() / volumes[best])
    said = f"{count - 1} smaller parts or hollows left out, together {100 * rest:.3g} % of the largest part's volume."
    return TriangleMesh(mesh.vertices[used], faces.reshape(-1, 3)), [said]


def _taubin(mesh: TriangleMesh) -> TriangleMesh:
    import trimesh

    loose = mesh.as_trimesh()
    trimesh.smoothing.filter_taubin(loose, lamb=0.5, nu=0.53, iterations=10)  # type: ignore[no-untyped-call]
    return TriangleMesh(loose.vertices, loose.faces)
