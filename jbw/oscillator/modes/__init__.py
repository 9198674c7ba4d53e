"""Several modes about one joint."""
