"""Diagnoses of models, and series of one robot over many days."""
