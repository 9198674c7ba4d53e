"""Results from draws: summaries, checks and verdicts."""
