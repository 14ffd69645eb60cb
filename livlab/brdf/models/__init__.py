"""BRDF models: lobes and their sums."""
