"""Readers of matrix files, one module per format."""
