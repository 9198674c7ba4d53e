"""Comparison of the joint's predictions of tests with their measurements: bands, errors, noise."""
