"""Observables, one module per kind of test: reduce its records, predict them, weigh residuals."""
