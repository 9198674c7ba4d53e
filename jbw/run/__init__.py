"""The folder of a run in progress: manifest, lock, checkpoints, interruption."""
