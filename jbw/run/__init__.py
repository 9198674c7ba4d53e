"""The run's folder while a run is under way: manifest, lock, checkpoints, interruption."""
