"""The faults that records may have, one file for each, and simple checks of samples."""
