"""Structures of several modes that are coupled by joints."""
