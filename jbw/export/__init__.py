"""The export of a joint to other programs: one draw of a posterior, with the bands of all draws."""
