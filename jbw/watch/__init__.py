"""One joint watched: readings at fixed amplitudes, and tests of change of a stated rate."""
