"""Simulation-based calibration: how often intervals contain the true value."""
