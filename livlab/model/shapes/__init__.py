"""Geometry: shapes as triangle meshes in mm, distances to them, shells, sections. No renderer."""

from livlab.model.shapes.checks import check
from livlab.model.shapes.creases import creased
from livlab.model.shapes.distance import DistanceField, distance_field
from livlab.model.shapes.mesh import TriangleMesh
from livlab.model.shapes.mesh_files import read_mesh, write_meshes
from livlab.model.shapes.organ import liver
from livlab.model.shapes.primitives import box, sphere
from livlab.model.shapes.section import MeshSection, Plane, section, wedge
from livlab.model.shapes.shell import Inset, Thickness, inset
from livlab.model.shapes.volume import Segmentation, SegmentedSurface, surface
from livlab.model.shapes.volume_files import read_volume

__all__ = [
    "DistanceField",
    "Inset",
    "MeshSection",
    "Plane",
    "Segmentation",
    "SegmentedSurface",
    "Thickness",
    "TriangleMesh",
    "box",
    "check",
    "creased",
    "distance_field",
    "inset",
    "liver",
    "read_mesh",
    "read_volume",
    "section",
    "sphere",
    "surface",
    "wedge",
    "write_meshes",
]
