"""The records of the rig, and readings of them that need no joint model."""
