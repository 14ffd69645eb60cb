"""The solvers of plane layers by cost, and which of them meets a wished accuracy."""
