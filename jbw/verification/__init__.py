"""The joint's prediction of a test, compared with its measurement: bands, errors and noise."""
