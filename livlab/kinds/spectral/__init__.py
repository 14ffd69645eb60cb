"""Experiments that measure the spectrum of a tissue with a virtual instrument."""
