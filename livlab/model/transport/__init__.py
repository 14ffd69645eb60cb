"""How light walks in plane layers."""
