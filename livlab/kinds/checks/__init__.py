"""Experiments that check livlab itself: the ladder of solvers and the hard cases."""
