"""Photographs of spheres: rig files, calibration, lights, pose, reading and merging."""
