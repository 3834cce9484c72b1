"""Estimators: how χ is solved for. Each class in a file here is one, found by its place; nothing else names it."""
