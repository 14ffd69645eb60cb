"""Scattering by single particles: spheres (Mie), cylinders, small particles (Rayleigh), spheroids."""
