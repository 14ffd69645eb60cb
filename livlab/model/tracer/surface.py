"""What a ray hits: a body's surface, its normal and curvature, or something else in the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from livlab.model.tracer.medium import packet
from livlab.model.transport.device import Device

FAR = 1e30
_ROW = 16
_EDGES = 8


@dataclass
class Hit:
    """What a ray hit.

    Attributes
    ----------
    valid, body, other
        Whether it hit anything; the body's surface; something else.
    interface
        Which of the body's surfaces.
    p, t
        Where.
    facet, normal
        Outward normal of the surface itself, and smoothed between its vertices.
    outward
        Whether the ray came from outside.
    found, ray
        What Mitsuba knows, to be asked for more.
    """

    valid: Any
    body: Any
    other: Any
    interface: Any
    p: Any
    t: Any
    facet: Any
    normal: Any
    outward: Any
    found: Any
    ray: Any


class Surface:
    """The surfaces of a body.

    A triangle mesh's normals are kept in one row a triangle, which one look-up brings; other shapes are left to
    Mitsuba.
    """

    def __init__(self, d: Device, mi: Any, scene: Any, shapes: Sequence[Any]) -> None:
        self.d, self.mi, self.dr, self.scene, self.shapes = d, mi, d.dr, scene, list(shapes)
        self.meshes = bool(self.shapes) and all(s.is_mesh() for s in self.shapes)
        if self.meshes:
            rows, edges, starts = [], [], [0]
            for shape in self.shapes:
                a, b = _rows(mi, shape)
                rows.append(a)
                edges.append(b)
                starts.append(starts[-1] + len(a))
            self.starts = [d.dr.opaque(mi.UInt32, n) for n in starts[:-1]]
            self.rows, self.edges = (mi.Float(np.concatenate(x).ravel()) + 0.0 for x in (rows, edges))
            d.dr.eval(self.rows, self.edges)

    def intersect(self, ray: Any, cast: Any) -> Hit:
        """Cast a ray."""
        dr, mi = self.dr, self.mi
        found = self.scene.ray_intersect_preliminary(ray, coherent=False, active=cast)
        valid = cast & found.is_valid()
        interface, body = mi.UInt32(0), mi.Bool(False)
        for k, shape in enumerate(self.shapes):
            mine = found.shape == shape
            body |= mine
            interface = dr.select(mine, mi.UInt32(k), interface)
        body &= valid
        t = dr.select(valid, found.t, FAR)
        if self.meshes:
            p, facet, smooth = self._of_mesh(found, interface, ray, body)
        elif self.shapes:
            si = found.compute_surface_interaction(ray, mi.RayFlags.Minimal | mi.RayFlags.ShadingFrame, valid)
            p, facet, smooth = si.p, mi.Vector3f(si.n), mi.Vector3f(si.sh_frame.n)
        else:
            p, facet = dr.fma(ray.d, t, ray.o), mi.Vector3f(0.0, 0.0, 1.0)
            smooth = facet
        outward = dr.dot(facet, ray.d) < 0.0
        # A smoothed normal that looks away from the ray would send its light through the surface.
        agrees = (dr.dot(smooth, ray.d) < 0.0) == outward
        return Hit(
            valid=valid,
            body=body,
            other=valid & ~body,
            interface=interface,
            p=p,
            t=t,
            facet=facet,
            normal=dr.select(agrees, smooth, facet),
            outward=outward,
            found=found,
            ray=ray,
        )

    def _of_mesh(self, found: Any, interface: Any, ray: Any, active: Any) -> tuple[Any, Any, Any]:
        dr, mi = self.dr, self.mi
        row = packet(mi, dr, self.rows, self._triangle(found, interface), _ROW, active)
        facet = mi.Vector3f(*row[:3])
        u, v = found.prim_uv.x, found.prim_uv.y
        smooth = mi.Vector3f(*(row[4 + k] + u * row[7 + k] + v * row[10 + k] for k in range(3)))
        p = dr.fma(ray.d, found.t, ray.o)
        # Along a ray from afar the distance loses digits; the triangle's plane has them.
        off = dr.dot(facet, p) - row[3]
        return dr.fma(facet, -off, p), facet, dr.normalize(smooth)

    def _triangle(self, found: Any, interface: Any) -> Any:
        start = self.starts[0]
        for k in range(1, len(self.starts)):
            start = self.dr.select(interface == k, self.starts[k], start)
        return start + found.prim_index

    def curvature(self, hit: Hit, active: Any) -> tuple[Any, Any, Any, Any]:
        """Tangents of the surface at a hit, and how its normal turns along them."""
        dr, mi = self.dr, self.mi
        if not self.meshes:
            flags = mi.RayFlags.ShadingFrame | mi.RayFlags.dPdUV | mi.RayFlags.dNSdUV
            si = hit.found.compute_surface_interaction(hit.ray, flags, active)
            return si.dp_du, si.dp_dv, si.dn_du, si.dn_dv
        which = self._triangle(hit.found, hit.interface)
        edge = packet(mi, dr, self.edges, which, _EDGES, active)
        row = packet(mi, dr, self.rows, which, _ROW, active)
        turns, normal = [], dr.select(active, hit.normal, 0.0)  # no hit has no normal, not even a number
        for k in (7, 10):
            along = mi.Vector3f(*row[k : k + 3])
            turns.append(along - normal * dr.dot(normal, along))
        return mi.Vector3f(*edge[:3]), mi.Vector3f(*edge[3:6]), turns[0], turns[1]


def _rows(mi: Any, shape: Any) -> tuple[Any, Any]:
    """(T, 16) facet normal, its plane, and a vertex's normal with its differences to the others; (T, 8) two edges."""
    data = mi.traverse(shape)
    points = np.array(data["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    faces = np.array(data["faces"], dtype=np.int64).reshape(-1, 3)
    a, b, c = (points[faces[:, k]] for k in range(3))
    facet = np.cross(b - a, c - a)
    length = np.linalg.norm(facet, axis=1, keepdims=True)
    facet = facet / np.where(length > 0, length, 1.0)
    if shape.has_flipped_normals():
        facet = -facet
    if shape.has_vertex_normals() and not shape.has_face_normals():
        normals = np.array(data["vertex_normals"], dtype=np.float64).reshape(-1, 3)
        if shape.has_flipped_normals():
            normals = -normals
        na, nb, nc = (normals[faces[:, k]] for k in range(3))
    else:
        na = nb = nc = facet
    rows = np.zeros((len(faces), _ROW), dtype=np.float32)
    rows[:, :3], rows[:, 3] = facet, np.einsum("ij,ij->i", facet, a)
    rows[:, 4:7], rows[:, 7:10], rows[:, 10:13] = na, nb - na, nc - na
    edges = np.zeros((len(faces), _EDGES), dtype=np.float32)
    edges[:, :3], edges[:, 3:6] = b - a, c - a
    return rows, edges


def other_shapes(d: Device, mi: Any, scene: Any, bodies: Sequence[Any]) -> list[Any]:
    """Shapes that are no body's and not just a lamp's black surface."""
    own = {s.id() for s in bodies}
    return [s for s in scene.shapes() if s.id() not in own and not (s.is_emitter() and _black(d, mi, s))]


def _black(d: Device, mi: Any, shape: Any) -> bool:
    """Whether a lamp's surface reflects nothing, as it does unless a scene says otherwise."""
    bsdf = shape.bsdf()
    if bsdf is None:
        return True
    if int(bsdf.flags()) & ~int(mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide):
        return False
    si = d.dr.zeros(mi.SurfaceInteraction3f)
    si.wavelengths = mi.UnpolarizedSpectrum(450.0, 530.0, 610.0, 690.0)
    return not bool((np.array(bsdf.eval_diffuse_reflectance(si)) > 0.0).any())
