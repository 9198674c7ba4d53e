"""Checks of records against their description: one file per property or kind of test."""
