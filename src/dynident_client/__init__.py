"""Python client of the dynident HTTP service."""
