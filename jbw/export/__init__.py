"""The export of a joint to other programs: one posterior draw, with the bands of all draws."""
