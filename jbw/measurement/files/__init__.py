"""One reader a file format, and one door that checks what was read."""
