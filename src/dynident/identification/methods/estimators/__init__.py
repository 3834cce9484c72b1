"""Estimators: how χ is solved for. Each file here is one, and nothing else names it."""
