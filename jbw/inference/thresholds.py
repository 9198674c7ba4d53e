"""Thresholds that findings, tables and figures share; importing them does not load JAX."""

from scipy.special import chdtri

PROB = 0.99
"""Probability of the intervals."""
THRESHOLD = float(chdtri(1, 1 - PROB))  # 6.63, the threshold of chi-square
"""Rise of chi-square at the ends of a profile's interval."""
BEYOND = 1.05
"""Displacement / largest fitted displacement above which a prediction is an extrapolation."""
KNOWN, ROUGHLY = 0.05, 0.3
"""Largest standard deviation / mean of an identified and of a roughly identified parameter."""
LEARNT = 0.5
"""Least information gain [nats] of a constrained parameter (sd 0.61 times that of the prior)."""
