"""Frequency and damping of one mode against amplitude, read from a record, with errors."""
