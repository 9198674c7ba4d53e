"""Comparison of joint laws on one campaign: the best law, and those that data distinguish."""
