"""Equations of motion of structures with joints: force laws, simulation, steady responses."""
