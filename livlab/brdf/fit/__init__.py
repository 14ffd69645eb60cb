"""Fitting BRDF models to samples."""
