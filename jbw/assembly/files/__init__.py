"""Readers of matrices, one a format."""
