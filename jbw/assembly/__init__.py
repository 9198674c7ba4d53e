"""Matrices of a finite-element model, reduced to modes and joints."""
