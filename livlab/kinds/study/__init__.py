"""Experiments that vary parameters: sweeps, sensitivities, ablations."""
