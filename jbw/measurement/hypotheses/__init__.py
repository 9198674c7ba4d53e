"""Faults of records as hypotheses: one file each, fitted together with the mode and compared."""
