"""A joint for other programs: one draw of a posterior, between the bands of all."""
