"""Where parameters live: boxes, priors, coordinates that compose."""
