"""Likelihood terms, one module per kind of test: reduction of records, prediction, weights."""
