"""Storage of the service: a database for small values and rows, an object store for large files."""
