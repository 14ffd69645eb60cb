"""Experiments that fit a tissue to measurements."""
