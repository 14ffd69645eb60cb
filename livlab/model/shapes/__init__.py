"""Geometry: shapes as triangle meshes in mm, distances to them, shells, sections. No renderer."""

from livlab.model.shapes.distance import DistanceField, distance_field, signed_distance
from livlab.model.shapes.mesh import TriangleMesh
from livlab.model.shapes.organ import liver
from livlab.model.shapes.primitives import box, sphere

__all__ = ["DistanceField", "TriangleMesh", "box", "distance_field", "liver", "signed_distance", "sphere"]
