"""Kinds of experiment: one folder each (`config`, `job`, tables, claims, `report`), and what runs them."""
