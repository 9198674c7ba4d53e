"""Campaign files: how they are read, checked, drafted, and described to editors."""
