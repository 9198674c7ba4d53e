"""Checks of records against what is said of them: one file a property or a kind of test."""
