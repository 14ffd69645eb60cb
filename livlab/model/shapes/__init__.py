"""Geometry: shapes as triangle meshes in mm, distances to them, shells, sections. No renderer."""

from livlab.model.shapes.checks import check
from livlab.model.shapes.distance import DistanceField, distance_field
from livlab.model.shapes.mesh import TriangleMesh
from livlab.model.shapes.organ import liver
from livlab.model.shapes.primitives import box, sphere
from livlab.model.shapes.section import Plane, Section, section, wedge
from livlab.model.shapes.shell import Inset, Thickness, inset

__all__ = [
    "DistanceField",
    "Inset",
    "Plane",
    "Section",
    "Thickness",
    "TriangleMesh",
    "box",
    "check",
    "distance_field",
    "inset",
    "liver",
    "section",
    "sphere",
    "wedge",
]
