"""Structures of several modes that share joints."""
