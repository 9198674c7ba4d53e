"""Thresholds that findings, tables and figures share; importing them does not load JAX."""

from scipy.special import chdtri

PROB = 0.99
"""Probability of the intervals."""
THRESHOLD = float(chdtri(1, 1 - PROB))  # 6.63, the threshold of chi-square
"""Rise of chi-square at the ends of a profile's interval."""
BEYOND = 1.05
"""Displacement / largest fitted displacement above which a prediction is an extrapolation."""
KNOWN, ROUGHLY = 0.05, 0.3
"""Standard deviation / mean up to which a parameter is identified, or roughly so."""
LEARNT = 0.5
"""Information gain [nats] that shows that the data constrain a parameter (0.61 of the prior)."""
