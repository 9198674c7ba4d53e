"""Inference from a log density, parameter names and bounds, independent of joint and test rig."""
