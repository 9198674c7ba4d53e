"""Least-squares fits, and the information of data about parameters."""
