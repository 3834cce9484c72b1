"""Measurements, their revisions, and imports that propose what the columns are."""
