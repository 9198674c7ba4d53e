"""The space of parameters: bounds, priors, and coordinates for samplers."""
