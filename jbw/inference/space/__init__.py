"""The parameter space: boxes, priors, and coordinates that can be composed."""
