"""Simulation-based calibration: tests of whether intervals contain the truth as stated."""
