"""The samplers of posteriors, one per file, and the control of long runs."""
