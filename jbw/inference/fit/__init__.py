"""Least-squares fits, and the accuracy with which data determine parameters."""
