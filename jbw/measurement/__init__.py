"""Records of tests, and quantities estimated from them without a model of a joint."""
