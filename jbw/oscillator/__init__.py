"""What the joint does: pure functions of (parameters, coordinate)."""
