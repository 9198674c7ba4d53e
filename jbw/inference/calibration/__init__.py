"""Simulation-based calibration: does a posterior hold the truth as often as it says?"""
