"""One module a kind of test: reduce the record, predict it, compare."""
