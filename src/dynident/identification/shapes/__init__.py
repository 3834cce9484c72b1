"""Shape constants inside an effect's columns: search, refinement, and their uncertainty."""
