"""BRDF file formats."""
