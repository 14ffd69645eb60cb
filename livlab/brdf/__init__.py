"""Reflectance from pictures of spheres: geometry, samples, tables, models and fits. Knows no renderer."""
