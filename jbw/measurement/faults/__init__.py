"""Faults of records: hypotheses, one file each, and plain checks of samples."""
