"""Limits of a motion: which they are, how to keep them, and how near a motion comes to each."""
