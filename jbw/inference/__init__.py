"""Bayesian inference from a log density with named, bounded parameters; it knows no joint."""
