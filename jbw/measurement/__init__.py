"""The records of tests, and estimates from them that need no model of a joint."""
