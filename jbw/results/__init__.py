"""Results as they are stored: one file of types for each kind of answer."""
