"""The space of the parameters: boxes, priors, and coordinates that compose."""
