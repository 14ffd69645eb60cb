"""Experiments that draw the figures of single-particle optics and of the chromophores."""
