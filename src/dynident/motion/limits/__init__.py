"""Limits of a motion: what they are, how to keep them, and the margin that is left."""
