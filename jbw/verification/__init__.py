"""What the joint predicts of a test, beside what was measured: bands, errors and noise."""
