"""Quantiles that intervals and bands are stated by."""

QUANTILES = (0.005, 0.5, 0.995)  # of a 99 % interval and its middle
