"""What draws say: the tree, summaries, checks, verdicts, comparisons, calibration."""
