"""Dynamics of the joint: pure functions of (parameters, coordinate)."""
