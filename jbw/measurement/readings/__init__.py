"""Readings of one mode from a record: frequency and damping against amplitude, with errors."""
