"""The types of stored results; each kind of answer has one file."""
