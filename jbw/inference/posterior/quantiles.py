"""The probabilities of the ends and the middle of all intervals and bands."""

QUANTILES = (0.005, 0.5, 0.995)  # ends and middle of a 99 % interval
