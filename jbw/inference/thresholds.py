"""Thresholds that findings, tables and figures share; importing them does not load JAX."""

from scipy.special import chdtri

PROB = 0.99
"""Of the intervals."""
THRESHOLD = float(chdtri(1, 1 - PROB))  # 6.63
"""Rise of chi-square at the ends of a profile's interval."""
BEYOND = 1.05
"""Of the largest fitted displacement: from where on a prediction is said to extrapolate."""
KNOWN, ROUGHLY = 0.05, 0.3
"""Standard deviation over mean, up to which a parameter is known, and known roughly."""
LEARNT = 0.5
"""Nats over the prior from which the data have said something: a prior narrowed to 0.61 of it."""
