"""Experiments that render pictures of organs."""
