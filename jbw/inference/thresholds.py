"""Thresholds that findings, tables and figures share; without JAX, which a report need not load."""

from scipy.special import chdtri

PROB = 0.99
"""Of the intervals."""
THRESHOLD = float(chdtri(1, 1 - PROB))  # 6.63
"""Rise of chi-square at the ends of a profile's interval."""
BEYOND = 1.05
"""Of the largest fitted displacement: from where on a prediction is said to extrapolate."""
