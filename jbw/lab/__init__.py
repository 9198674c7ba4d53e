"""Tests of the method: whether its intervals contain the truth, and whether its samplers agree."""
