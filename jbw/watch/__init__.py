"""The monitoring of one joint: readings at fixed amplitudes, and tests for a change."""
