"""Matrices of finite-element models, and their reduction to modes and joints."""
