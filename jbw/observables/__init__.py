"""Likelihood terms, one module per kind of test: reduce records, predict them, weigh residuals."""
