"""Results from draws: the tree, summaries, checks, verdicts, comparisons, calibration."""
