"""Inference from a log density, names and bounds, independent of joint and rig."""
