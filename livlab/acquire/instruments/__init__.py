"""Virtual instruments: spectrometers, spheres, fibre probes, cameras, the goniometer, the sphere rig."""
