"""What several kinds of experiment have in common."""
