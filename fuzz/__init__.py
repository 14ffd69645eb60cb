"""Fuzzing of every reader of a user's file: `python -m fuzz` by coverage (atheris), `tests/stress` by structure."""
