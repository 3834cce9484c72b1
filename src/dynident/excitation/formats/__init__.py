"""A design as files and documents."""
