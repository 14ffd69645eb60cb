"""The reference tracer and the renderer's door: the only package that imports Mitsuba."""
