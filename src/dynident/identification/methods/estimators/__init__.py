"""Estimators: how χ is solved for. Each file here is one, found by its place; nothing else names it."""
