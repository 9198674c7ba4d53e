"""Likelihoods of repeats, with offsets and scatter of runs."""
