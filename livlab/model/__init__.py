"""The forward model: tissue, its transport in plane layers, and the reference tracer."""
