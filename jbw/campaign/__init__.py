"""The campaign file: schema, loading, checking."""
