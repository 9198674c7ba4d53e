"""The records of the rig, and the readings of them that need no joint model."""
