"""Fitting tissue to measurements: problem, targets, scenes, forward models, intervals."""
