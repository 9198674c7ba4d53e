"""The faults that records may have, one per file, and plain checks of samples."""
