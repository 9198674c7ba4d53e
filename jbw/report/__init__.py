"""The figures and the one-file page of a run; they read results and compute none."""
