"""What the rig gives: records and what can be read off them without a joint model."""
