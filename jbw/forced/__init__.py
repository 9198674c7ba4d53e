"""Forced response of an identified joint: curves, base motion, random vibration and shock."""
