"""Repeats, and the offsets and scatter of runs."""
