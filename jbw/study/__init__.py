"""A campaign from its tests to everything that is kept of it."""
