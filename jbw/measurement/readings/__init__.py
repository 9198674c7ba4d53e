"""Frequency and damping of one mode against amplitude, measured in a record, with errors."""
