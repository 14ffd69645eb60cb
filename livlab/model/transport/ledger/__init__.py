"""Recorded walks that answer for other absorption and scattering without walking again."""
