"""Workflows of an identification: identify a model, extend it, remove effects, solve it again, store it."""
