"""Readings of one mode: frequency and damping against amplitude of a record, with their errors."""
