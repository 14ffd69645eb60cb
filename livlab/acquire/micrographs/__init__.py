"""Micrographs: volume fractions of what was stained."""
