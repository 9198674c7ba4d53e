"""The monitoring of a joint: frequency and damping at fixed amplitudes, and tests for a change."""
