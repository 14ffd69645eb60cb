"""Experiments that extract BRDFs from spheres."""
