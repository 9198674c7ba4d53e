"""Ways to draw from a posterior, one file each, and how long runs are kept."""
