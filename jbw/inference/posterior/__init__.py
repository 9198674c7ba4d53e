"""Results from posterior draws: summaries, checks and verdicts."""
