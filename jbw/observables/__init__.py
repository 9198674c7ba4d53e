"""One module a kind of test: reduce its records, predict them, weigh the difference."""
