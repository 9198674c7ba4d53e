"""Likelihoods of repeated records whose runs have offsets."""
