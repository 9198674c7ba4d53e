"""Readers of file formats, one each, and one entry point that checks what was read."""
