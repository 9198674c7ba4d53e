"""Comparison of the model's predictions with measured tests: bands, errors, coverage."""
