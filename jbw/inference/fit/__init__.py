"""Least squares, and what data know about parameters."""
