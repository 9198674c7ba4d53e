"""Least-squares fits, and how well data determine parameters."""
