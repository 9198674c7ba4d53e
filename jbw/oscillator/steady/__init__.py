"""Periodic responses of the oscillator with any laws."""
