"""The Monte Carlo walk through plane layers."""
