"""The probabilities of the ends and the middle of all intervals and bands."""

QUANTILES = (0.005, 0.5, 0.995)  # ends and middle of a 99 % interval
HALF_99 = 2.5758  # standard deviations to either side of a Gaussian 99 % interval
