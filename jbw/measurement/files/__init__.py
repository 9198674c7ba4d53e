"""Readers of file formats, one module each, and one function that reads and checks any file."""
