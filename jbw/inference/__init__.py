"""Bayesian inference from any log density with named, bounded parameters, without joint models."""
