"""Faults of records as hypotheses, one file each, fitted jointly with the mode and compared."""
