"""Run folders: their identity, their files, work in pieces, comparison."""
