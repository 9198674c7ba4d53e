"""Monitoring of a joint: its frequency and damping at fixed amplitudes are tested for a change."""
