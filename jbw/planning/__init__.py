"""Planning: what a test would tell of a joint that is only guessed, before it is measured."""
